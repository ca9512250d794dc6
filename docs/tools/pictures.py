# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Pictures of pages, written with `python docs/tools/pictures.py [NAME ...]`."""

from collections.abc import Callable, Sequence
from functools import partial
import json
from pathlib import Path
import shutil
import sys
from tempfile import TemporaryDirectory
from typing import Any
import warnings

from gallery import picture_of
from hnn_vi_ros import load_scene, Scene, simulate, simulate_many, simulate_spread
from hnn_vi_ros.control import assign
from hnn_vi_ros.errors import AlarmWarning
from hnn_vi_ros.identify import identify
from hnn_vi_ros.simulation import build
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import FancyBboxPatch
import numpy as np
from PIL import Image, ImageDraw
from sketch import GROUND, sketch

DOCS = Path(__file__).resolve().parents[1]
# The strip of scenes, and the side of each of its pictures [pixels].
SCENES = ('two_joint_arm', 'kepler', 'henon_heiles', 'fput_chain', 'heavy_top',
          'spherical_pendulum')
LINKAGES = ('gripper', 'four_bar', 'five_bar', 'delta_robot')
_SIDE, _TITLE, _GAP = 260, 26, 8
# The moving picture: simulated time [s], pictures a second [Hz], and how many colours.
_SECONDS, _RATE, _COLOURS = 6.0, 15.0, 32
# In models/: `hnn train --ensemble 5` with the configuration pendulum, two layers of 32 and 300
# steps of L-BFGS makes it.
_ENSEMBLE = 'pendulum5.safetensors'


def write_strip(path: Path, names: Sequence[str] = SCENES, columns: int = 3) -> None:
    """Draw scenes next to each other, in rows."""
    strip = Image.new('RGB', (columns * (_SIDE + _GAP) - _GAP,
                              len(names) // columns * (_SIDE + _TITLE + _GAP)), GROUND)
    pen = ImageDraw.Draw(strip)
    for k, name in enumerate(names):
        picture = picture_of(name)
        picture.thumbnail((_SIDE, _SIDE), Image.Resampling.LANCZOS)
        left, top = k % columns * (_SIDE + _GAP), k // columns * (_SIDE + _TITLE + _GAP)
        strip.paste(picture, (left + (_SIDE - picture.width) // 2,
                              top + _TITLE + (_SIDE - picture.height) // 2))
        pen.text((left + _SIDE // 2, top + 4), name, fill='white', anchor='ma', font_size=16)
    strip.quantize(128).save(path, optimize=True)


def write_moving(path: Path) -> None:
    """Draw the learned double pendulum in motion."""
    run = simulate(load_scene('double_pendulum'), duration=_SECONDS)
    samples = np.searchsorted(run.t, np.arange(0.0, _SECONDS, 1.0 / _RATE))
    frames = [sketch(run, k).quantize(_COLOURS, dither=Image.Dither.NONE)
              for k in samples.tolist()]
    frames[0].save(path, save_all=True, append_images=frames[1:], loop=0, optimize=True,
                   duration=round(1000.0 / _RATE))


def write_log_result(path: Path) -> None:
    """Cut the first panel and the axis of time out of the picture of the study bag_to_model."""
    with Image.open(DOCS / 'evidence' / 'bag_to_model.png') as picture:
        width, height = picture.size
        parts = [picture.convert('RGB').crop((0, round(top * height), width, round(end * height)))
                 for top, end in ((0.0, 0.4535), (0.9215, 1.0))]
    panel = Image.new('RGB', (width, sum(part.height for part in parts)))
    panel.paste(parts[0])
    panel.paste(parts[1], (0, parts[0].height))
    panel.thumbnail((720, 720), Image.Resampling.LANCZOS)
    panel.quantize(64).save(path, optimize=True)


def write_alarm_result(path: Path) -> None:
    """Draw the energy of rk4 with steps that are too large, with the alarms of the run."""
    with warnings.catch_warnings():
        warnings.simplefilter('ignore', AlarmWarning)
        run = simulate('pendulum', 20.0, integrator='rk4', step_size=0.4)
    figure, (axes,) = _figure(3.4)
    axes.plot(run.t, run.energy, linewidth=2.0, label='H of rk4, h = 0.4 s')
    axes.axhline(run.energy[0], color='black', linestyle='--', label='exact')
    for k, alarm in enumerate(run.alarms):
        t = alarm.step * 0.4
        axes.axvline(t, color='#c0143c', linestyle=':')
        axes.annotate(f'alarm: {alarm.kind}', (t, 11.3 - 1.1 * k), (5, 0), color='#c0143c',
                      textcoords='offset points', fontsize=12, bbox={
                          'facecolor': 'white', 'edgecolor': 'none', 'pad': 0.5})
    axes.set(xlabel='t [s]', ylabel='energy [J]')
    axes.legend(loc='upper right')
    figure.savefig(path, dpi=90)


def write_robot_result(path: Path) -> None:
    """Write a small copy of the recording of the arm with six joints."""
    with Image.open(DOCS / 'how-to' / 'recordings' / 'six_joint_arm.png') as picture:
        small = picture.convert('RGB').crop((0, 64, picture.width, 595))
    small.thumbnail((720, 720), Image.Resampling.LANCZOS)
    small.quantize(96).save(path, optimize=True)


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


def write_run(path: Path, name: str, duration: float) -> None:
    """Draw the series of a shipped scene, as `hnn run --plot` does."""
    simulate(load_scene(name), duration=duration).plot().savefig(path, dpi=90)


def write_energy(path: Path) -> None:
    """Draw the energy by cause of the scene on its page."""
    page = path.with_suffix('.md').read_text(encoding='utf-8')
    with TemporaryDirectory() as folder:
        scene = Path(folder) / 'motor_pendulum.yaml'
        scene.write_text(page.partition('```yaml\n')[2].partition('```')[0], encoding='utf-8')
        run = simulate(scene, energy_by_cause=True)
        run.plot_energy().savefig(path, dpi=100)


def write_loop_forces(path: Path) -> None:
    """Draw the force in the hinge that closes the four-bar linkage."""
    run = simulate('four_bar', duration=3.0)
    forces = run.loop_forces()[:, 0]
    figure, (axes,) = _figure(2.6)
    for axis, line in (('x', '-'), ('z', '--')):
        axes.plot(run.t, forces[:, 'xyz'.index(axis)], line, label=f'along {axis}')
    axes.set(xlabel='t [s]', ylabel='force on the coupler [N]')
    figure.legend(loc='outside upper right', ncols=2)
    figure.savefig(path, dpi=90)


def write_sensitivity(path: Path) -> None:
    """Draw the angle of a pendulum, and its derivatives by the initial angle and the length."""
    # Imported here: the other pictures need no torch.
    from hnn_vi_ros.torch import DifferentiableSimulation
    import torch
    simulation = DifferentiableSimulation('exact_pendulum', ['hamiltonian.length'])
    angle, length = (torch.tensor(value, dtype=torch.float64, requires_grad=True)
                     for value in ([2.5], 1.0))
    motion = simulation(angle, torch.zeros(1, dtype=torch.float64), duration=10.0, every=10,
                        parameters={'hamiltonian.length': length})
    figure, panels = _figure(3.6, rows=3)
    panels[0].plot(motion.t, motion.q.detach())
    for axes, unknown in zip(panels[1:], (angle, length), strict=True):
        axes.plot(motion.t, [torch.autograd.grad(q, unknown, retain_graph=True)[0].item()
                             for q in motion.q[:, 0]])
    for axes, title in zip(panels, (
            'angle [rad]', 'its derivative with respect to the initial angle',
            'its derivative with respect to the length [rad/m]'), strict=True):
        axes.set_title(title, loc='left', fontsize=9)
    panels[-1].set_xlabel('t [s]')
    figure.savefig(path, dpi=110)


def write_orders(path: Path) -> None:
    """Draw the error after a second of a non-separable system over the step size."""
    def end(method: str, steps: int) -> np.ndarray:
        run = simulate('tao', 1.0, integrator=method, step_size=1.0 / steps)
        return np.append(run.q[-1], run.p[-1])

    exact, steps = end('gauss16', 64), np.array([8, 16, 32, 64, 128, 256])
    figure, (axes,) = _figure(4.2)
    for method, mark in zip(('variational_euler', 'generalized_leapfrog', 'yoshida4', 'gauss4',
                             'gauss6', 'gauss8'), 'os^Dv*', strict=True):
        errors = np.array([np.abs(end(method, n) - exact).max() for n in steps.tolist()])
        # Less is rounding.
        shown = errors > 1e-15
        axes.loglog(1.0 / steps[shown], errors[shown], mark + '-', label=method)
    axes.set(xlabel='step size h [s]', ylabel='largest error of q and p after 1 s')
    figure.legend(loc='outside right upper', fontsize=8)
    figure.savefig(path, dpi=110)


def write_sweep(path: Path) -> None:
    """Draw the angles at the end of a sweep over initial states."""
    q, p = (grid.reshape(-1, 1) for grid in np.meshgrid(
        np.linspace(-3.1, 3.1, 62), np.linspace(-7.0, 7.0, 46)))
    many = simulate_many('exact_pendulum', q=q, p=p, duration=3.0)
    figure, (axes,) = _figure(4.2)
    found = axes.scatter(q, p, c=np.cos(many.q[-1]), cmap='viridis', s=22, marker='s')
    axes.set(xlabel='initial angle [rad]', ylabel='initial momentum [kg m2/s]')
    figure.colorbar(found, label='cosine of the angle after 3 s')
    figure.savefig(path, dpi=110)


def write_fit(path: Path) -> None:
    """Draw the figure of `identify`: a fit to noisy data of a damped, driven pendulum."""
    run = simulate('exact_damped_driven_pendulum', 6.0, every=2)
    rng = np.random.default_rng(1)
    with TemporaryDirectory() as folder:
        data = Path(folder) / 'log.npz'
        np.savez(data, t=run.t, q=run.q + rng.normal(0.0, 0.05, run.q.shape))
        identify.main(['exact_damped_driven_pendulum', '--data', str(data), '--free', 'length',
                       'damping.rate', '--out', f'{folder}/report'])
        shutil.copyfile(Path(folder) / 'report' / identify.FIT, path)


def write_bands(path: Path) -> None:
    """Draw a motion with its band, and the errors of many; `train --ensemble` made the model."""
    # Imported here: the other pictures need no torch.
    from hnn_vi_ros.learning.fit.config import find_config, load_config
    from hnn_vi_ros.learning.judging.ensemble import held_exact, scores_of
    from hnn_vi_ros.models.checkpoint import load_checkpoint
    model = DOCS.parent / 'models' / _ENSEMBLE
    scene = _learned(model, uncertainty={})
    same: dict[str, Any] = {'integrator': 'gauss8', 'every': 5, 'initial_state': ([3.1], [0.0])}
    found = simulate_spread(scene, 30.0, **same)
    exact = simulate('exact_pendulum', 30.0, step_size=scene.step_size, **same)
    figure = Figure(figsize=(9.0, 3.6), layout='constrained')
    left, right = figure.subplots(1, 2, width_ratios=[1.5, 1.0])
    t, mean, half = found.mean.t, found.mean.q[:, 0], found.spread_q[:, 0]
    left.fill_between(t, mean - half, mean + half, color='#0072b2', alpha=0.3, linewidth=0.0,
                      label='band of 90 %')
    left.plot(t, mean, color='#0072b2', label='mean of five networks')
    left.plot(t, exact.q[:, 0], 'k--', linewidth=1.0, label='exact pendulum')
    left.set(xlabel='t [s]', ylabel='angle [rad]', xlim=(0.0, 30.0),
             title='a motion next to the separatrix')
    figure.legend(loc='outside upper center', ncols=3, fontsize=9)
    checkpoint, config = (load_checkpoint(str(model), ensembles=True),
                          load_config(find_config('pendulum')))
    held, card = held_exact(checkpoint, config, 3000, config.seed + 3), checkpoint.card.ensemble
    assert held is not None and card is not None and card.factors is not None
    relative = scores_of(checkpoint, held) / np.array(card.factors)
    ratios = np.sort(relative[held.inside[1:]].ravel())
    share = np.arange(1, ratios.size + 1) / ratios.size
    inside = float(np.mean(ratios <= 1.0))
    right.plot(ratios, share, color='#0072b2')
    right.axvline(1.0, color='grey', linestyle=':')
    right.plot(1.0, inside, 'o', color='#d55e00')
    right.annotate(f'{inside:.0%} of errors\nare within the band', (1.0, inside), (1.2, 0.55),
                   arrowprops={'arrowstyle': '->', 'color': '#d55e00'})
    right.set(xlim=(0.0, 3.0), ylim=(0.0, 1.02), xlabel='error / half-width of the band',
              ylabel='share of errors below',
              title=f'{held.inside[1:].any(axis=0).sum()} new motions of 7.5 s')
    for axes in (left, right):
        axes.grid(alpha=0.3)
    figure.savefig(path, dpi=110)


def write_learned(path: Path) -> None:
    """Train on a log by the configuration of the tutorial, and draw the model's motion."""
    # Imported here: the other pictures need no torch.
    from hnn_vi_ros.learning import train
    rng, rows = np.random.default_rng(0), []
    for k, angle in enumerate(np.linspace(0.3, 2.4, 8)):
        run = simulate('exact_pendulum', 3.0, integrator='gauss8', step_size=0.01,
                       initial_state=([angle], [0.0]))
        rows.append(np.column_stack([np.full(len(run.t), k), run.t,
                                     np.hstack([run.q, run.p]) + rng.normal(
                                         0.0, 1e-3, (len(run.t), 2))]))
    text = (DOCS / 'tutorials' / 'train.md').read_text(encoding='utf-8')
    with TemporaryDirectory() as folder:
        log, config, model = (Path(folder) / f'pendulum.{end}' for end in (
            'csv', 'yaml', 'safetensors'))
        np.savetxt(log, np.vstack(rows), '%.6g', ',', header='swing,t,angle,momentum', comments='')
        config.write_text(text.partition('```yaml\n')[2].partition('```')[0], encoding='utf-8')
        train.main(['--config', str(config), '--data', str(log), '--out', str(model)])
        scene = _learned(model)
        runs = [simulate(one, 10.0, integrator='gauss8', initial_state=([1.0], [0.0]))
                for one in (load_scene('exact_pendulum'), scene)]
    figure, (axes,) = _figure(3.2)
    for run, line, label in zip(runs, ('-', '--'), ('pendulum', 'learned from the log'),
                                strict=True):
        axes.plot(run.t, run.q[:, 0], line, label=label)
    axes.set(xlabel='t [s]', ylabel='angle [rad]')
    figure.legend(loc='outside upper right', ncols=2)
    figure.savefig(path, dpi=110)


def write_machines(path: Path) -> None:
    """Draw the errors of models of machines relative to other models."""
    results = DOCS / 'evidence' / 'learning' / 'machines.json'
    rows = [row for row in json.loads(results.read_text('utf-8'))
            if row['measure'].startswith('RMS')]
    named: dict[str, dict[str, dict[str, Any]]] = {}
    for row in rows:
        name = (f'{row["case"].removeprefix("real ")}: '
                f'{row["measure"].removeprefix("RMS error [rad] ")}')
        named.setdefault(name, {})[row['model']] = row
    figure, (axes,) = _figure(0.42 * len(named) + 1.3)
    marks = {'default': ('o', '#0072b2', 9.0), 'networks': ('^', '#56b4e9', 6.0),
             'rigid body and networks': ('s', '#009e73', 5.5),
             'plain network': ('x', '#d55e00', 7.0)}
    for (model, (mark, color, size)), above in zip(
            marks.items(), (-0.24, -0.08, 0.08, 0.24), strict=True):
        for k, models in enumerate(named.values()):
            row = models['default']
            values = models[model]['ours'] if model in models else row['baselines'][model]
            axes.plot(np.divide(values, row['reference']), [k + above] * len(values), mark,
                      color=color, markersize=size, label='' if k else model)
    axes.axvspan(0.4, 1.0, color='#0072b2', alpha=0.06)
    axes.axvline(1.0, color='grey', linestyle=':')
    axes.set_xscale('log', base=2)
    axes.set(xlim=(0.45, None), yticks=range(len(named)), yticklabels=list(named),
             xlabel='error of each joint / error of the best of others (shaded: ours is smaller)')
    axes.xaxis.set_major_formatter('{x:g}')
    axes.tick_params('y', labelsize=8)
    axes.invert_yaxis()
    figure.legend(loc='outside upper right', ncols=4, fontsize=8)
    figure.savefig(path, dpi=110)


def write_flow(path: Path) -> None:
    """Draw the architecture: boxes by column and row, and the arrows between them."""
    boxes = {
        'scene.yaml': (0, 1, ''), 'Scene': (1, 1, 'scene/'),
        'model.safetensors': (0, 0, ''),
        'Kernel of H': (1, 0, 'models/, hamiltonians/,\nkernels/'),
        'Simulation': (2, 1, 'simulation/,\nintegrators/, effects/'),
        'Trajectory': (3, 0, 'simulation/trajectory/,\nsweeps/'), 'Run': (3, 1, 'run/, ros/run/'),
        'alarms': (4, 2, 'simulation/guards/'), 'topics': (4, 1, 'ros/topics/'),
        'bag, picture': (4, 0, 'recording/')}
    arrows = [('scene.yaml', 'Scene'), ('Scene', 'Simulation'), ('Kernel of H', 'Simulation'),
              ('model.safetensors', 'Kernel of H'), ('Simulation', 'Run'),
              ('Simulation', 'Trajectory'), ('Run', 'alarms'), ('Run', 'topics'),
              ('Run', 'bag, picture')]
    figure = Figure(figsize=(9.0, 3.4))
    axes = figure.add_axes((0.0, 0.0, 1.0, 1.0))
    axes.set(xlim=(-0.5, 4.5), ylim=(-0.5, 2.5))
    axes.axis('off')
    for name, (x, y, rooms) in boxes.items():
        axes.add_patch(FancyBboxPatch((x - 0.37, y - 0.27), 0.74, 0.54, facecolor='#eaf2f8',
                                      edgecolor='#0072b2', boxstyle='round,pad=0.03'))
        axes.text(x, y + (0.12 if rooms else 0.0), name, ha='center', va='center', fontsize=9,
                  weight='bold')
        axes.text(x, y - 0.09, rooms, ha='center', va='center', fontsize=7)
    for start, end in arrows:
        (x, y, _), (to, at, _) = boxes[start], boxes[end]
        axes.annotate('', (to - 0.41, at), (x + 0.41, y), arrowprops={'arrowstyle': '-|>'})
    figure.savefig(path, dpi=110)


def write_swing_up(path: Path) -> None:
    """Draw the swing-up of a pendulum by its model, and by the guess that the tutorial has."""
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
    left.set(xlabel='t [s]', title='angle [half turns]')
    left.legend()
    right.set(xlabel='t [s]', title='torque [N m]')
    for axes in (left, right):
        axes.grid(alpha=0.3)
    figure.savefig(path, dpi=110)


def _learned(model: Path, **more: Any) -> Scene:
    """Return the scene of a learned pendulum."""
    return load_scene('pendulum').changed(
        {'hamiltonian': {'kind': 'learned', 'model': str(model)}, **more})


def _figure(height: float, rows: int = 1) -> tuple[Figure, list[Axes]]:
    """Return a figure and its stacked panels."""
    figure = Figure(figsize=(8.0, height), layout='constrained')
    panels = list(figure.subplots(rows, 1, sharex=True, squeeze=False)[:, 0])
    for axes in panels:
        axes.grid(alpha=0.3)
    return figure, panels


PICTURES: dict[str, Callable[[Path], None]] = {
    '_static/result_log.png': write_log_result,
    '_static/result_alarm.png': write_alarm_result,
    '_static/result_robot.png': write_robot_result,
    '_static/scenes.png': write_strip, '_static/double_pendulum.gif': write_moving,
    'concepts/architecture.png': write_flow, 'evidence/orders.png': write_orders,
    'how-to/identify_fit.png': write_fit,
    'how-to/linkages.png': partial(write_strip, names=LINKAGES, columns=4),
    'how-to/loop-forces.png': write_loop_forces, 'how-to/machines.png': write_machines,
    'how-to/sensitivity.png': write_sensitivity, 'how-to/sweep.png': write_sweep,
    'how-to/uncertainty.png': write_bands, 'how-to/where-energy-goes.png': write_energy,
    'tutorials/csv.png': write_learned, 'tutorials/hover.png': write_hover,
    'tutorials/oscillator.png': partial(write_run, name='harmonic_oscillator', duration=20.0),
    'tutorials/swing-up.png': write_swing_up,
    'tutorials/arm.png': partial(write_run, name='two_joint_arm', duration=5.0)}

if __name__ == '__main__':
    for name in sys.argv[1:] or PICTURES:
        PICTURES[name](DOCS / name)
