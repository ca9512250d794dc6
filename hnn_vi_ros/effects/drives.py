# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""
Measured drives by name.

Numbers were identified by the project Rhoban/bam on a pendulum, in its friction models m1 (Coulomb
and viscous) and m2 (with the Stribeck curve); the friction of m3 to m6 depends on the load as
that of no effect here. M. Duclusaud, G. Passault et al., Extended friction models for the
physics simulation of servo actuators, 2024.

sts3215_so101 was fitted here to positions of the servo of the arm SO-101 at 12 V, which
swung .5 and 1.2 kg at .10 and .15 m with gains kp of 4 to 32: a voltage of .163 kp 12 V per radian
of error, .025 s after the command, while the motor is switched off at once. Its controller makes
ramps of the commanded positions. In 120 runs of 6 s that the fit did not use, simulated from their
first sample with `servo` and `joint_friction` in steps of 2.5 ms, the mean absolute error of the
angle is .0217 rad: .0173 with the motor on, .050 while it is off. A sharper dry friction and
smaller steps change it by .0001. Two repetitions of a run differ by .010 rad.
"""

from typing import NamedTuple

from hnn_vi_ros.errors import listed


class Drive(NamedTuple):
    """
    Numbers of a drive, at its output.

    Parameters
    ----------
    source : str
        File of the repository Rhoban/bam with the numbers, or the runs that they were fitted to.
    volts : float or None
        Largest voltage [V]: of the supply, times the largest duty cycle; None if not limiting.
    torque_constant, resistance : float
        k_t [N m/A], [V s/rad] and R [Ohm].
    inertia : float
        Reflected inertia of the rotor [kg m^2].
    friction, stribeck : float
        Coulomb friction, and the excess of static friction [N m].
    damping : float
        Viscous friction, without the back EMF [N m s/rad].
    speed, exponent : float or None
        Stribeck speed [rad/s] and exponent of the curve [1]; None for m1.
    rate_limit : float or None
        Largest rate of commanded positions [rad/s]; None for none.
    punch, load : float
        Torque of the least voltage [N m], and friction relative to the torque [1]; see `servo`.

    """

    source: str
    volts: float | None
    torque_constant: float
    resistance: float
    inertia: float
    friction: float
    stribeck: float
    damping: float
    speed: float | None = None
    exponent: float | None = None
    punch: float = 0.0
    load: float = 0.0
    rate_limit: float | None = None

    @property
    def torque_limit(self) -> float | None:
        """Return the torque at rest and the largest voltage, V k_t / R [N m]."""
        return None if self.volts is None else self.volts * self.torque_constant / self.resistance

    @property
    def back_emf(self) -> float:
        """Return the torque that the back EMF takes from that of a voltage, k_t^2 / R [N m s]."""
        return self.torque_constant**2 / self.resistance

    @property
    def no_load_speed(self) -> float | None:
        """Return the speed at which the back EMF is the largest voltage, V / k_t [rad/s]."""
        return None if self.volts is None else self.volts / self.torque_constant


DRIVES = {
    'mx64': Drive('params/mx64/m2.json', 15.0 * 0.9625, 1.62043816, 3.89442165, 0.0119236649,
                  0.0561193176, 0.0818641155, 0.0191808464, 1.12025096, 3.0),
    'mx106': Drive('params/mx106/m2.json', 15.0 * 0.9625, 2.19095857, 2.96090458, 0.0268388319,
                   2.7685552e-06, 0.117421215, 0.0595893945, 1.84878055, 1.74138927),
    'xl320': Drive('params/xl320/m1.json', 7.5, 0.986947134, 35.6090973, 0.00111895062,
                   0.0275145043, 0.0, 0.00331760758),
    'xl330': Drive('params/xl330/m2.json', 7.4, 0.300072007, 3.42235147, 0.00183519493,
                   0.00198861885, 0.00558535452, 0.0119552332, 1.95062114, 1.69140922),
    'erob80_50': Drive('params/erob80_50/m1.json', None, 4.54339887, 2.50882149, 0.336938736,
                       4.0966475, 0.0, 1.29805795),
    'sts3215_7v4': Drive('params/feetech_sts3215_7_4V/m1.json', 7.4 * 0.97, 1.21164135, 2.67616633,
                         0.0284033635, 0.0523929608, 0.0, 0.0590851557),
    'sts3215_so101': Drive('kscalelabs/sysid, March 2025', 12.0, 2.18539, 3.70517, 0.02638,
                           0.12729, 0.0, 0.04584, punch=0.21744, load=0.31498,
                           rate_limit=5.0636),
    'sts3215_12v': Drive('params/feetech_sts3215_12V/m1.json', 12.0 * 0.97, 1.4439859, 2.0295625,
                         0.0324599941, 0.195871178, 0.0, 0.0304735065),
}


def find_drive(name: str) -> Drive:
    """Return the drive of this name, or raise ValueError with the valid names."""
    if name not in DRIVES:
        raise ValueError(f'no drive {name!r}; valid drives: {listed(DRIVES)}')
    return DRIVES[name]
