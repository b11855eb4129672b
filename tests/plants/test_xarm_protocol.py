"""The protocol of the controller, byte by byte, and the states of the emulated one."""

from __future__ import annotations

import struct

import numpy as np
import pytest
from support import small_tasks

from oimppi_warp.errors import ConfigError
from oimppi_warp.network import split_address
from oimppi_warp.plants.xarm.codes import describe
from oimppi_warp.plants.xarm.controller import ACCELERATION, EmulatedController
from oimppi_warp.plants.xarm.protocol import Mode, Register, Request, State, floats, report, seven, take_requests


@pytest.fixture
def controller() -> EmulatedController:
    return EmulatedController(small_tasks.shipped("lab01").robot)


def ask(controller: EmulatedController, register: int, data: bytes = b"") -> tuple[int, bytes]:
    """The status and the data of the reply to a command."""
    frame = controller.handle(Request(7, 3, register, data))
    assert struct.unpack(">HHH", frame[:6]) == (7, 3, len(frame) - 6)
    assert frame[6] == register
    return frame[7], frame[8:]


def ready(controller: EmulatedController) -> None:
    ask(controller, Register.ENABLE, b"\x08\x01")
    ask(controller, Register.SET_MODE, b"\x04\x00")
    ask(controller, Register.SET_STATE, b"\x00")


def move(controller: EmulatedController, speed: float, duration: float) -> int:
    velocity = floats(seven([speed, 0, 0, 0, 0, 0]))
    return ask(controller, Register.JOINT_VELOCITY, velocity + b"\0" + floats([duration]))[0]


def test_requests_are_cut_out_of_a_stream():
    first = bytes.fromhex("0001 0002 0003 0b 0801".replace(" ", ""))
    second = bytes.fromhex("0002 0002 0001 0d".replace(" ", ""))
    heartbeat = bytes.fromhex("0000 0001 0002 0000".replace(" ", ""))
    buffer = bytearray(first + heartbeat + second[:5])
    assert take_requests(buffer) == [Request(1, 2, 11, b"\x08\x01")]
    assert take_requests(buffer) == []
    buffer += second[5:]
    assert take_requests(buffer) == [Request(2, 2, 13, b"")]
    assert not buffer


def test_a_reply_repeats_the_number_of_its_request():
    assert Request(258, 2, 13, b"").reply(0x10, b"\x04") == bytes.fromhex("0102 0002 0003 0d 10 04".replace(" ", ""))


def test_reports_have_the_length_and_the_places_that_the_sdk_expects(controller):
    joints = np.array([0.1, -0.5, -0.4, 0.3, 1.0, 0.6])
    ready(controller)
    controller.sense(joints, 0.1 * joints, 10 * joints, np.zeros(6), np.array([0.3, 0.0, 0.2]))
    seen = controller.snapshot()
    for kind, length in (("real", 87), ("normal", 145), ("rich", 314)):
        frame = report(kind, seen)
        assert struct.unpack(">I", frame[:4])[0] == len(frame) == length
        assert frame[4] == Mode.JOINT_VELOCITY << 4 | State.READY
        assert np.frombuffer(frame, "<f4", 7, 7) == pytest.approx([*joints, 0.0])
        assert np.frombuffer(frame, "<f4", 3, 35) == pytest.approx([300.0, 0.0, 200.0])
        assert np.frombuffer(frame, "<f4", 7, 59) == pytest.approx([*10 * joints, 0.0])
    assert frame[87:89] == b"\x3f\x3f"
    assert np.frombuffer(frame, "<f4", 1, 115)[0] == pytest.approx(0.2)
    assert frame[145:149] == b"\x06\x06\xaa\x55"
    assert np.frombuffer(frame, "<f4", 7, 256) == pytest.approx([*0.1 * joints, 0.0])


def test_nothing_moves_before_it_is_enabled_in_velocity_mode_and_ready(controller):
    not_ready = 0x10
    assert move(controller, 0.1, 0.2) & not_ready
    ask(controller, Register.ENABLE, b"\x08\x01")
    assert ask(controller, Register.GET_STATE)[1] == bytes([State.MODE_CHANGED])
    assert move(controller, 0.1, 0.2) & not_ready
    ask(controller, Register.SET_STATE, b"\x00")
    assert move(controller, 0.1, 0.2) & not_ready, "in position mode"
    ask(controller, Register.SET_MODE, b"\x04\x00")
    assert move(controller, 0.1, 0.2) & not_ready, "a mode takes effect with the state ready"
    ask(controller, Register.SET_STATE, b"\x00")
    assert move(controller, 0.1, 0.2) == 0
    assert controller.tick(0.004)[0] > 0.0
    assert ask(controller, Register.GET_STATE)[1] == bytes([State.MOVING])
    assert (controller.moves, controller.refused) == (1, 4)


def test_a_velocity_expires_within_the_limit_of_acceleration(controller):
    ready(controller)
    move(controller, 1.0, 0.1)
    driven = np.array([controller.tick(0.004)[0] for _ in range(60)])
    assert driven.max() == pytest.approx(1.0)
    assert np.abs(np.diff([0.0, *driven])).max() <= ACCELERATION * 0.004 + 1e-9
    assert np.sum(driven > 0.99) * 0.004 == pytest.approx(0.1 - 1.0 / ACCELERATION, abs=0.01)
    assert driven[-1] == 0.0
    assert controller.expired == 1


def test_without_a_duration_a_velocity_goes_on_for_ever(controller):
    ready(controller)
    ask(controller, Register.JOINT_VELOCITY, floats(seven([0.3])) + b"\0")
    assert [controller.tick(1.0)[0] for _ in range(100)][-1] == pytest.approx(0.3)
    ask(controller, Register.SET_STATE, b"\x04")
    assert controller.tick(1.0)[0] == 0.0


@pytest.mark.parametrize(
    ("measured", "code"),
    [({"contact": np.full(6, 30.0)}, 31), ({"joints": np.full(6, 9.0)}, 23), ({"velocities": np.full(6, 4.0)}, 24)],
)
def test_an_error_stops_the_arm_until_it_is_cleared(controller, measured, code):
    ready(controller)
    move(controller, 0.5, 10.0)
    still = {name: np.zeros(6) for name in ("joints", "velocities", "torques", "contact")} | {"tip": np.zeros(3)}
    still["joints"] = np.array([0.0, -0.5, -0.5, 0.0, 1.0, 0.0])
    controller.sense(**still | measured)
    assert ask(controller, Register.GET_ERROR)[1] == bytes([code, 0])
    assert move(controller, 0.5, 10.0) & 0x40
    assert controller.tick(1.0)[0] == 0.0
    controller.sense(**still)
    ready(controller)
    assert move(controller, 0.5, 10.0) & 0x40, "ready again does not clear it"
    ask(controller, Register.CLEAR_ERROR)
    ready(controller)
    assert move(controller, 0.5, 10.0) == 0


def test_a_parameter_that_is_missing_is_no_crash(controller):
    ready(controller)
    for register in (Register.JOINT_VELOCITY, Register.SET_MODE, Register.SET_LOAD, Register.ENABLE):
        assert ask(controller, register)[0] & 0x08
    assert ask(controller, 199)[0] == 0, "what is not emulated does nothing"


def test_errors_are_put_in_words():
    assert "C31: a collision" in describe(31)
    assert "UFACTORY Studio" in describe(31)
    assert "C99: an error that is not known here" in describe(99)


@pytest.mark.parametrize(
    ("address", "found"),
    [("192.168.1.7", ("192.168.1.7", 5)), ("box:80", ("box", 80)), ("::1", ("::1", 5)), ("[::1]:80", ("::1", 80))],
)
def test_addresses(address, found):
    assert split_address(address, 5) == found


@pytest.mark.parametrize("address", ["", "box:", "box:x", "box:0", "box:70000", ":80"])
def test_what_is_no_address(address):
    with pytest.raises(ConfigError, match="no address"):
        split_address(address, 5)
