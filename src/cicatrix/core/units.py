"""Unit conversions. Internally all quantities are in mm, kg and s, hence mN, kPa and uJ; only this module converts.

1 kPa = 1 mN/mm2 = 1 kg/(mm s2), and 1 mN mm = 1 uJ, so no factor appears in any formula. Healing time is
counted in days. Every function takes a number or an array and returns the same type.
"""

from __future__ import annotations

import math
from typing import TypeVar

import numpy as np

Value = TypeVar("Value", float, np.ndarray)

STANDARD_GRAVITY_M_S2 = 9.80665
HOURS_PER_DAY = 24.0
DAYS_PER_WEEK = 7.0


def density_kg_mm3(density_kg_m3: Value) -> Value:
    """Mass density: [kg/m3] -> [kg/mm3]."""
    return density_kg_m3 * 1e-9


def density_kg_m3(density_kg_mm3: Value) -> Value:
    """Mass density: [kg/mm3] -> [kg/m3]."""
    return density_kg_mm3 * 1e9


def acceleration_mm_s2(acceleration_m_s2: Value) -> Value:
    """Acceleration: [m/s2] -> [mm/s2]."""
    return acceleration_m_s2 * 1e3


def mm_from_um(length_um: Value) -> Value:
    """Length: [um] -> [mm]."""
    return length_um * 1e-3


MM_PER = {"mm": 1.0, "cm": 10.0, "m": 1000.0}


def mm_from(length: Value, unit: str) -> Value:
    """Length: [unit: mm, cm or m] -> [mm]."""
    return length * MM_PER[unit]


def um_from_mm(length_mm: Value) -> Value:
    """Length: [mm] -> [um]."""
    return length_mm * 1e3


def days_from_hours(time_hours: Value) -> Value:
    """Time: [h] -> [days]."""
    return time_hours / HOURS_PER_DAY


def hours_from_days(time_days: Value) -> Value:
    """Time: [days] -> [h]."""
    return time_days * HOURS_PER_DAY


def seconds_from_hours(time_hours: Value) -> Value:
    """Time: [h] -> [s]."""
    return time_hours * 3600.0


def hours_from_seconds(time_s: Value) -> Value:
    """Time: [s] -> [h]."""
    return time_s / 3600.0


def days_from_seconds(time_s: Value) -> Value:
    """Time: [s] -> [days]."""
    return days_from_hours(hours_from_seconds(time_s))


def seconds_from_days(time_days: Value) -> Value:
    """Time: [days] -> [s]."""
    return seconds_from_hours(hours_from_days(time_days))


def days_from_weeks(time_weeks: Value) -> Value:
    """Time: [weeks] -> [days]."""
    return time_weeks * DAYS_PER_WEEK


def weeks_from_days(time_days: Value) -> Value:
    """Time: [days] -> [weeks]."""
    return time_days / DAYS_PER_WEEK


def ml_from_mm3(volume_mm3: Value) -> Value:
    """Volume: [mm3] -> [ml]."""
    return volume_mm3 * 1e-3


def kpa_from_pn_um2(stress_pn_um2: Value) -> Value:
    """Stress at the cell scale, where units are pN, um and s: [pN/um2] -> [kPa]."""
    return stress_pn_um2 * 1e-3


def pn_um2_from_kpa(stress_kpa: Value) -> Value:
    """Stress at the cell scale: [kPa] -> [pN/um2]."""
    return stress_kpa * 1e3


UNIT_FACTORS = {  # (case-file unit, internal unit): factor that converts a value from the first to the second
    ("min", "s"): 60.0,
    ("h", "s"): 3600.0,
    ("d", "s"): 86_400.0,
    ("1/h", "1/s"): 1.0 / 3600.0,
    ("1/d", "1/s"): 1.0 / 86_400.0,
    ("um", "mm"): 1e-3,
    ("Pa", "kPa"): 1e-3,
    ("MPa", "kPa"): 1e3,
    ("MPa", "pN/um^2"): 1e6,
    ("deg", "rad"): math.pi / 180.0,
}


def unit_factor(typed: str, inner: str) -> float:
    """Return the factor that converts a value from its case-file unit to the law's internal unit; 1 for equal units."""
    return 1.0 if typed == inner else UNIT_FACTORS[typed, inner]
