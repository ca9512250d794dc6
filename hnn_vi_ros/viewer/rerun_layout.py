# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Static parts of a rerun recording: names, colours, frames, and what stands still."""

from collections.abc import Mapping, Sequence
import re

from hnn_vi_ros.hamiltonians.base import Hamiltonian
from hnn_vi_ros.mechanisms.parts import Ball, Line, Part, Trail
from hnn_vi_ros.phase_space import column_units, columns, Coordinate, momentum_name
from hnn_vi_ros.viewer.phase_portrait import contours, Frame, ticks
import numpy as np
import rerun as rr

PALETTE = ((88, 166, 255), (242, 165, 65), (86, 211, 100), (219, 109, 190), (121, 216, 217),
           (255, 123, 114), (210, 168, 255), (225, 210, 90))
BACKGROUND, INK, GREY, WHITE = (13, 17, 23), (170, 180, 195), (72, 82, 98), (245, 247, 250)
# What samples cost, with the unit, by entity.
TIMING = {'/timing/microseconds_per_step': ['p50 [µs]', 'p99 [µs]'],
          '/timing/real_time_factor': ['real-time factor']}
# The bands around coordinates and momenta.
BANDS = '/state/q_band', '/state/p_band'
_SUPERSCRIPTS = str.maketrans('-0123456789', '⁻⁰¹²³⁴⁵⁶⁷⁸⁹')
LOW, HIGH = np.array([38, 62, 104]), np.array([92, 138, 190])


def raised(unit: str) -> str:
    """Return a unit with its exponents as superscripts: kg m²/s of kg m2/s."""
    return re.sub('(?<=[A-Za-z])-?[0-9]+', lambda power: power[0].translate(_SUPERSCRIPTS), unit)


def phase_path(coordinate: Coordinate) -> str:
    """Return the entity that holds a coordinate's phase portrait."""
    return f'/phase/{rr.escape_entity_path_part(coordinate.name)}'


def part_path(name: str) -> str:
    """Return the entity that holds a part of the mechanism."""
    return f'/world/{rr.escape_entity_path_part(name)}'


def series_labels(coordinates: Sequence[Coordinate], relative: bool, conservative: bool,
                  modified: bool, invariants: Sequence[str] = (), band: bool = False
                  ) -> dict[str, list[str]]:
    """
    Return what each series is called, with its unit, by entity.

    Parameters
    ----------
    coordinates : sequence of Coordinate
        One series each under ``/state/q`` and ``/state/p``.
    relative : bool
        Whether the energy error is relative to H0.
    conservative : bool
        Whether no effect does work; else the work W is shown.
    modified : bool
        Whether a modified energy is known, to be shown where no work is done.
    invariants : sequence of str, optional
        Names of what else is conserved; one series each.
    band : bool, optional
        Whether there are bands around q and p: their lower ends, then their upper ones.

    """
    error = 'H - H0' if conservative else 'H - H0 - W'
    second = {} if conservative else {'/energy/work': ['work W [J]']}
    if conservative and modified:
        second = {'/energy/modified': ['modified H [J]']}
    (q_names, p_names), (q_units, p_units) = columns(coordinates), column_units(coordinates)
    bands = {BANDS[0]: q_names, BANDS[1]: [momentum_name(name) for name in p_names]}
    return {
        '/state/q': [f'{name} [{raised(unit)}]'
                     for name, unit in zip(q_names, q_units, strict=True)],
        '/state/p': [f'{momentum_name(name)} [{raised(unit)}]'
                     for name, unit in zip(p_names, p_units, strict=True)],
        **({path: [f'{name} {end}' for end in ('lowest', 'highest') for name in names]
            for path, names in bands.items()} if band else {}),
        '/energy/H': ['H [J]'],
        **second,
        '/energy/error': [f'({error}) / |H0|' if relative else f'{error} [J]'],
        **({'/invariants': list(invariants)} if invariants else {}),
    }


def without_unit(names: Sequence[str]) -> tuple[list[str], str]:
    """Return several names without the unit that all of them have, and ' [it]' for a title."""
    parts = [name.rpartition(' [') for name in names]
    unit = parts[0][2]
    if len(names) < 2 or not parts[0][1] or any(part[1:] != (' [', unit) for part in parts):
        return list(names), ''
    return [name for name, _, _ in parts], f' [{unit}'


def log_series_styles(stream: rr.RecordingStream, labels: Mapping[str, Sequence[str]]) -> None:
    """Name and colour every series."""
    first = {'/energy/modified': 2, '/energy/work': 1, '/energy/error': 5, '/invariants': 4,
             '/timing/microseconds_per_step': 3, '/timing/real_time_factor': 6}
    for path, names in labels.items():
        start = first.get(path, 0)
        # The ends of a band are thin lines in the colours of the curve inside it.
        thin = path in BANDS
        count = len(names) // 2 if thin else len(names)
        colors = [PALETTE[(start + i % count) % len(PALETTE)] for i in range(len(names))]
        style = rr.SeriesLines(colors=colors, names=without_unit(names)[0],
                               widths=[0.7 if thin else 2.0] * len(names))
        stream.log(path, style, static=True, strict=True)


def log_phase_portrait(stream: rr.RecordingStream, hamiltonian: Hamiltonian, frame: Frame,
                       q0: np.ndarray, p0: np.ndarray, side: float) -> None:
    """
    Draw the energy contours, the frame and its ticks, and set how trail and state look.

    ``side`` is the width of the frame in points, for the places of the labels.

    Every point is logged as (q, p). The entity's transform turns the frame into the square from
    -1 to 1 with p upwards, since a 2D view has its y axis down and equal scales.
    """
    coordinate = hamiltonian.coordinates[frame.axis]
    path = phase_path(coordinate)
    levels = contours(hamiltonian, frame, q0, p0)
    strips = [line for _, lines in levels for line in lines]
    shares = np.repeat(np.linspace(0.0, 1.0, len(levels)), [len(lines) for _, lines in levels])
    colors = (LOW + shares[:, None] * (HIGH - LOW)).astype(np.uint8)
    (q_low, q_high), (p_low, p_high) = frame.q, frame.p
    half_q, half_p = 0.5 * (q_high - q_low), 0.5 * (p_high - p_low)
    still = {
        '': rr.Transform3D(scale=[1.0 / half_q, -1.0 / half_p, 1.0],
                           translation=[-0.5 * (q_low + q_high) / half_q,
                                        0.5 * (p_low + p_high) / half_p, 0.0]),
        '/contours': rr.LineStrips2D(strips, colors=colors, radii=rr.Radius.ui_points(0.6)),
        '/frame': _frame_lines(frame),
        '/labels': _frame_labels(frame, coordinate, side),
        '/trail': rr.LineStrips2D.from_fields(colors=[PALETTE[1]], draw_order=30.0,
                                              radii=rr.Radius.ui_points(1.25)),
        '/state': rr.Points2D.from_fields(colors=[WHITE], radii=rr.Radius.ui_points(5.0),
                                          draw_order=40.0),
    }
    for child, archetype in still.items():
        stream.log(path + child, archetype, static=True, strict=True)


def _frame_lines(frame: Frame) -> rr.LineStrips2D:
    (left, right), (low, high) = frame.q, frame.p
    strips = [[(left, low), (right, low), (right, high), (left, high), (left, low)]]
    dash_q, dash_p = 0.015 * (right - left), 0.015 * (high - low)
    strips += [[(q, low), (q, low + dash_p)] for q in ticks(frame.q)]
    strips += [[(left, p), (left + dash_q, p)] for p in ticks(frame.p)]
    return rr.LineStrips2D(strips, colors=[GREY], radii=rr.Radius.ui_points(0.6))


def _frame_labels(frame: Frame, coordinate: Coordinate, side: float) -> rr.Points2D:
    """Place the labels; the viewer writes each just below its point, so p's labels are raised."""
    (left, right), (low, high) = frame.q, frame.p
    # One point, in the units of each axis.
    dq, dp = (right - left) / side, (high - low) / side
    texts = {(q, low - 2.0 * dp): f'{q:g}' for q in ticks(frame.q)}
    texts |= {(left - 24.0 * dq, p + 15.0 * dp): f'{p:g}' for p in ticks(frame.p)}
    texts[0.5 * (left + right), low - 32.0 * dp] = (
        f'{coordinate.name} [{raised(coordinate.q_unit)}]')
    texts[left + 15.0 * dq, high + 42.0 * dp] = (
        f'{momentum_name(coordinate.name)} [{raised(coordinate.p_unit)}]')
    return rr.Points2D(list(texts), labels=list(texts.values()), show_labels=True, colors=[INK],
                       radii=rr.Radius.ui_points(0.01))


def log_mechanism_styles(stream: rr.RecordingStream, parts: Mapping[str, Part]) -> None:
    """Draw the parts that stand still, and set how those that move look."""
    stream.log('/world', rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True, strict=True)
    for name, part in parts.items():
        still: rr.AsComponents
        if isinstance(part, Line):
            still = rr.LineStrips3D.from_fields(
                strips=None if part.moves else [part.points], radii=[part.radius],
                colors=[part.color])
        elif isinstance(part, Trail):
            still = rr.LineStrips3D.from_fields(radii=[part.radius], colors=[part.color])
        elif isinstance(part, Ball):
            still = rr.Ellipsoids3D.from_fields(
                centers=None if part.moves else [part.center], half_sizes=[3 * [part.radius]],
                colors=[part.color], fill_mode=rr.components.FillMode.Solid)
        else:
            still = rr.Boxes3D.from_fields(
                centers=None if part.moves else [part.center], half_sizes=[part.half_size],
                colors=[part.color], fill_mode=rr.components.FillMode.Solid)
        stream.log(part_path(name), still, static=True, strict=True)
