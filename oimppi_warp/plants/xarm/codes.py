"""Errors of the xArm's controller in words, each with what to do.

What the codes mean is taken from the vendor's SDK and manual; the words and the advice are ours. The controller is
never asked to clear one.
"""

from __future__ import annotations

COLLISION, SELF_COLLISION, JOINT_LIMIT, TOO_FAST = 31, 22, 23, 24
"""Codes of errors that the emulation raises by itself."""

_SUPPORT = "press the emergency stop, and contact the vendor's support"
_ERRORS: dict[int, tuple[str, str]] = {
    1: ("the emergency stop is pressed", "release it"),
    2: ("the emergency stop input of the control box is triggered", "release it"),
    3: ("the emergency stop of the three-state switch is pressed", "release it"),
    11: ("motor 1 has an error", "look up its code in UFACTORY Studio"),
    12: ("motor 2 has an error", "look up its code in UFACTORY Studio"),
    13: ("motor 3 has an error", "look up its code in UFACTORY Studio"),
    14: ("motor 4 has an error", "look up its code in UFACTORY Studio"),
    15: ("motor 5 has an error", "look up its code in UFACTORY Studio"),
    16: ("motor 6 has an error", "look up its code in UFACTORY Studio"),
    17: ("motor 7 has an error", "look up its code in UFACTORY Studio"),
    18: ("the force sensor does not answer", "switch it off in UFACTORY Studio, it is not used"),
    19: ("the tool's communication fails", "check the plug at the wrist"),
    21: ("the kinematics of a command have no solution", "move the arm away from where it is stretched"),
    22: ("the arm would collide with itself", "move it apart by hand (manual mode)"),
    23: ("a joint is at its limit", "move it back by hand (manual mode)"),
    24: ("a joint was commanded to move too fast", "use a lower --speed, and report it: plans keep the arm's limits"),
    25: ("planning failed in the controller", "restart the control box"),
    26: ("the controller's real-time system failed", _SUPPORT),
    27: ("the controller did not answer a command", "try again, then restart the control box"),
    28: ("the module at the end of the arm does not answer", "restart the control box"),
    30: ("a joint reported a speed above its limit", _SUPPORT),
    31: (
        "a collision was detected: a motor's current differs from what the controller expects",
        "look what the arm touches and move it free by hand; if it touches nothing, set the payload (docs/hardware.md)",
    ),
    33: ("the controller's input and output module fails", "check its plugs, and restart the control box"),
    35: ("the arm is at the safety boundary that is set in the controller", "move it back by hand, or widen it"),
    36: ("too many delayed commands are waiting in the controller", "close other programs that command the arm"),
    37: ("the arm moved abnormally in manual mode", "set payload and mounting in UFACTORY Studio"),
    38: ("a joint's angle is abnormal", _SUPPORT),
    39: ("the power board of the controller fails", _SUPPORT),
    40: ("a trajectory of the joints could not be solved", "move the arm to another posture by hand"),
    50: ("the force sensor cannot be read", "switch it off in UFACTORY Studio, it is not used"),
    51: ("the force sensor's mode cannot be set", "switch it off in UFACTORY Studio, it is not used"),
    52: ("the force sensor cannot be zeroed", "switch it off in UFACTORY Studio, it is not used"),
    53: ("the force sensor is overloaded", "see what presses on the tool"),
    60: ("the tool was too fast in servo mode", "close other programs that command the arm"),
    110: ("the robot's base board does not answer", _SUPPORT),
    111: ("the external device at the control box does not answer", "check its plug"),
}


def describe(code: int) -> str:
    """Returns an error of the controller in words, with what to do.

    Args:
        code: The code, as the controller reports it.
    """
    meaning, remedy = _ERRORS.get(code, ("an error that is not known here", "look it up in the controller's manual"))
    return f"the controller reports C{code}: {meaning}\n  to do:   {remedy}; then clear the error in UFACTORY Studio"
