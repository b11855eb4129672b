"""The task that an engine of the robot level is built from."""

from dataclasses import replace

import pytest
from support.small_tasks import rollout_task, shipped


def test_a_weight_of_the_cost_to_go_without_one_is_an_error():
    task = rollout_task(shipped("task01"))
    with pytest.raises(ValueError, match="to_go is needed"):
        replace(task, cost=replace(task.cost, w_to_go=1.0))
