# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Pictures of README and tutorials: `python docs/pictures.py` in the environment writes them."""

from pathlib import Path

from gallery import picture_of
from hnn_vi_ros import load_scene, simulate
from hnn_vi_ros.control.task import assign
from hnn_vi_ros.simulation.build import build
import numpy as np
from PIL import Image, ImageDraw
from sketch import sketch

HERE = Path(__file__).resolve().parent
# Of the strip, and the side of each of its pictures [pixels].
SCENES = ('double_pendulum', 'kepler', 'henon_heiles', 'fput_chain', 'heavy_top',
          'spherical_pendulum')
_SIDE, _TITLE, _GAP = 260, 26, 8
# Of the moving picture: simulated time [s], pictures a second [Hz], and how many colours.
_SECONDS, _RATE, _COLOURS = 6.0, 15.0, 32


def write_strip(path: Path) -> None:
    """Draw six scenes beside each other, in two rows."""
    columns = len(SCENES) // 2
    strip = Image.new('RGB', (columns * (_SIDE + _GAP) - _GAP, 2 * (_SIDE + _TITLE + _GAP)),
                      'white')
    pen = ImageDraw.Draw(strip)
    for k, name in enumerate(SCENES):
        picture = picture_of(name)
        picture.thumbnail((_SIDE, _SIDE), Image.Resampling.LANCZOS)
        left, top = k % columns * (_SIDE + _GAP), k // columns * (_SIDE + _TITLE + _GAP)
        strip.paste(picture, (left + (_SIDE - picture.width) // 2,
                              top + _TITLE + (_SIDE - picture.height) // 2))
        pen.text((left + _SIDE // 2, top + 4), name, fill='black', anchor='ma', font_size=16)
    strip.quantize(128).save(path, optimize=True)


def write_moving(path: Path) -> None:
    """Draw the learned double pendulum in motion."""
    run = simulate(load_scene('double_pendulum'), duration=_SECONDS)
    samples = np.searchsorted(run.t, np.arange(0.0, _SECONDS, 1.0 / _RATE))
    frames = [sketch(run, k).quantize(_COLOURS, dither=Image.Dither.NONE)
              for k in samples.tolist()]
    frames[0].save(path, save_all=True, append_images=frames[1:], loop=0, optimize=True,
                   duration=round(1000.0 / _RATE))


def write_hover(path: Path) -> None:
    """Draw the quadrotor on its way to where the task `hover` holds it."""
    from matplotlib.figure import Figure
    ready = assign('hover')
    run, place = build(load_scene('quadrotor')), np.array(ready.task.controller.place)
    rows = []
    for _ in range(600):
        run.advance(round(ready.task.period / run.step_size))
        commands = ready.controller(run.q, run.hamiltonian.gradient(run.q, run.p)[1], run.time)
        rows.append([run.time, *(run.q[:3] - place), commands[0]])
        run.set_command(commands)
    t, *away, thrust = np.array(rows).T
    figure = Figure(figsize=(8.0, 3.0), layout='constrained')
    left, right = figure.subplots(1, 2)
    for name, values, line in zip('xyz', away, ('-', '--', '-.'), strict=True):
        left.plot(t, values, line, label=name)
    left.set(xlabel='t [s]', title='distance from the place [m]')
    left.legend()
    right.plot(t, thrust)
    right.axhline(0.8 * 9.81, color='grey', linewidth=0.8, linestyle=':', label='weight')
    right.set(xlabel='t [s]', title='thrust [N]')
    right.legend()
    for axes in (left, right):
        axes.grid(alpha=0.3)
    figure.savefig(path, dpi=110)


def write_swing_up(path: Path) -> None:
    """Draw the swing-up of a pendulum by its model, and by the guess that the tutorial has."""
    from matplotlib.figure import Figure
    truth = load_scene('motor_pendulum')
    guess = truth.changed({
        'hamiltonian': {'kind': 'pendulum', 'mass': 0.7, 'length': 1.3},
        'effects': [{'kind': 'damping', 'rate': 0.2}, truth.effects[1].model_dump()]})
    figure = Figure(figsize=(8.0, 3.0), layout='constrained')
    left, right = figure.subplots(1, 2)
    for name, model, line in (('identified', truth, '-'), ('guessed', guess, '--')):
        ready, run, rows = assign('swing_up', model), build(truth), []
        period = ready.task.period
        for k in range(round(8.0 / period)):
            u = ready.controller(run.q, run.hamiltonian.gradient(run.q, run.p)[1], k * period)
            rows.append([k * period, run.q[0] / np.pi, u[0]])
            run.set_command(u)
            run.advance(round(period / run.step_size))
        t, angle, torque = np.array(rows).T
        left.plot(t, angle, line, label=f'{name} model')
        right.plot(t, torque, line)
    left.set(xlabel='t [s]', title='angle over a half turn')
    left.legend()
    right.set(xlabel='t [s]', title='torque [N m]')
    for axes in (left, right):
        axes.grid(alpha=0.3)
    figure.savefig(path, dpi=110)


if __name__ == '__main__':
    write_strip(HERE / 'scenes.png')
    write_moving(HERE / 'double_pendulum.gif')
    write_hover(HERE / 'hover.png')
    write_swing_up(HERE / 'tutorials' / 'swing-up.png')
