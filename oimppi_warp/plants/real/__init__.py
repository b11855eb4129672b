"""The plant of a real arm, whatever its interface: sends commands, stops at faults, moves to the start posture."""
