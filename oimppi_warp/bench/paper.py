"""The paper's reported results, for comparison with ours.

Source: Tables I and II of N. Raicevic, B. R. Radhakrishnan, C. Yu, K. M. B. Lee, N. Atanasov, *Object-Informed Model
Predictive Path Integral Control for Non-Prehensile Robot Manipulation*. Ten trials per task in simulation (Table I),
and five on the real arm (Table II), to which our simulated lab tasks correspond.
"""

from __future__ import annotations

from dataclasses import dataclass

METHODS = ("mppi", "cloi", "soi")
"""The paper's methods, in the order of its tables."""


@dataclass(frozen=True)
class Reported:
    """One cell of a table in the paper.

    Attributes:
        table: ``I`` or ``II``.
        success: Success rate, from 0 to 1.
        error_m: Position error averaged over time (epsilon_d) [m]; ``None`` if the paper does not report it.
        error_success_m: The same for successful trials alone (epsilon_d^s) [m]; ``None`` if there are none.
        control_hz: Control frequency (f) [Hz]; ``None`` if the paper does not report it.
        total_time_s: Total time (T) [s], where a failed trial counts with the longest time allowed; ``None`` if the
            paper does not report it.
        preplan_time_s: Part of the total time that SOI spends planning in advance [s]; ``None`` for other methods.
    """

    table: str
    success: float
    error_m: float | None = None
    error_success_m: float | None = None
    control_hz: float | None = None
    total_time_s: float | None = None
    preplan_time_s: float | None = None


REPORTED: dict[tuple[str, str], Reported] = {
    ("task01", "mppi"): Reported("I", 0.9, 0.35, 0.35, 2.51, 117),
    ("task01", "cloi"): Reported("I", 1.0, 0.27, 0.27, 3.25, 153),
    ("task01", "soi"): Reported("I", 1.0, 0.33, 0.33, 2.49, 108, 71),
    ("task02", "mppi"): Reported("I", 0.4, 0.37, 0.29, 2.42, 249),
    ("task02", "cloi"): Reported("I", 0.9, 0.30, 0.30, 3.00, 167),
    ("task02", "soi"): Reported("I", 1.0, 0.34, 0.34, 2.39, 134, 87),
    ("task03", "mppi"): Reported("I", 0.0, 0.42, None, 2.19, 345),
    ("task03", "cloi"): Reported("I", 0.3, 0.35, 0.29, 5.64, 272),
    ("task03", "soi"): Reported("I", 0.9, 0.34, 0.33, 2.23, 181, 131),
    ("task04", "mppi"): Reported("I", 0.2, 0.62, 0.46, 2.23, 313),
    ("task04", "cloi"): Reported("I", 0.7, 0.36, 0.33, 2.80, 222),
    ("task04", "soi"): Reported("I", 0.9, 0.30, 0.27, 2.27, 235, 104),
    ("task05", "mppi"): Reported("I", 0.6, 0.34, 0.24, 2.52, 153),
    ("task05", "cloi"): Reported("I", 0.7, 0.31, 0.25, 3.00, 160),
    ("task05", "soi"): Reported("I", 0.3, 0.29, 0.14, 2.47, 256, 111),
    ("lab01", "mppi"): Reported("II", 1.0, 0.30, 0.30, 4.04, 115),
    ("lab01", "cloi"): Reported("II", 1.0, 0.38, 0.38, 2.85, 114),
    ("lab01", "soi"): Reported("II", 1.0, 0.35, 0.35, 4.08, 95, 17),
    ("lab02", "mppi"): Reported("II", 0.4, 0.32, 0.13, 3.80, 233),
    ("lab02", "cloi"): Reported("II", 0.8, 0.32, 0.29, 2.69, 230),
    ("lab02", "soi"): Reported("II", 0.8, 0.32, 0.28, 3.88, 215, 16),
}
"""Results by task and method; ``task03_wide`` is not in the paper."""

MEANS: dict[tuple[str, str], Reported] = {
    ("I", "mppi"): Reported("I", 0.42, 0.42, 0.32, 2.38, 236),
    ("I", "cloi"): Reported("I", 0.72, 0.32, 0.29, 3.01, 195),
    ("I", "soi"): Reported("I", 0.82, 0.32, 0.29, 2.37, 183, 101),
    ("II", "mppi"): Reported("II", 0.7, 0.31, 0.25, 3.92, 174),
    ("II", "cloi"): Reported("II", 0.9, 0.35, 0.34, 2.77, 172),
    ("II", "soi"): Reported("II", 0.9, 0.34, 0.32, 3.98, 155, 17),
}
"""Mean results by table and method, as printed in the paper."""

TABLES = {
    "I": ("task01", "task02", "task03", "task04", "task05"),
    "II": ("lab01", "lab02"),
}
"""Tasks of each table."""
