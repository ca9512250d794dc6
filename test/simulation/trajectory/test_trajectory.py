# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Trajectories: their names and units, and what they are drawn, shown and handed over as."""

from dataclasses import replace
from itertools import combinations
import math
import sys

from hnn_vi_ros.errors import MissingPackage, RecordingError
from hnn_vi_ros.phase_space import Coordinate
from hnn_vi_ros.scene import load_scene, Scene
from hnn_vi_ros.simulation import simulate, simulate_many, Trajectory
from hnn_vi_ros.simulation.trajectory.figures import ALARM, COLOURS, draw_curves, MOST_NAMED
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure
from messages import refused
import numpy as np
import pytest
from rerun_reader import read
from safetensors.numpy import save_file

T = np.linspace(0.0, 2.0, 41)
COORDINATES = (Coordinate('x', 'm', 'kg m/s'), Coordinate('y', 'm', 'kg m/s'),
               Coordinate('turn', 'rad', 'kg m2/s'))
WAVES = np.stack([np.sin(T), np.cos(T), 0.1 * T], axis=-1)
PLAIN = Trajectory(T, WAVES, -WAVES, 1.0 + 0.01 * T, COORDINATES)
MANY = Trajectory(T, np.stack([k * WAVES for k in range(10)], axis=1),
                  np.stack([WAVES] * 10, axis=1), np.ones((41, 10)), COORDINATES,
                  alarms=((),) * 10)
TURNING = Trajectory(T, np.ones((41, 4)), np.ones((41, 3)), T, (Coordinate(
    'body', '1', 'kg m2/s', 'rotation'),))


@pytest.fixture(scope='module')
def run() -> Trajectory:
    scene = Scene.build(
        hamiltonian='pendulum', integrator='stormer_verlet', step_size=0.05,
        initial_state=([1.0], [0.0]), mechanism='pendulum', name='swing',
        events=[{'when': 'angle = 0', 'direction': 'down'}])
    return simulate(scene, 2.0)


def lightness(colour: str) -> float:
    """Return L* of CIE 1976, from 0 to 100."""
    linear = [c / 12.92 if c <= 0.04045 else ((c + 0.055) / 1.055) ** 2.4 for c in to_rgb(colour)]
    y = np.dot([0.2126, 0.7152, 0.0722], linear)
    return 116.0 * y ** (1 / 3) - 16.0 if y > 0.008856 else 903.3 * y


def test_trajectory_knows_its_names_units_and_scene(run):
    assert run.names == (['angle'], ['p_angle'])
    assert run.units == {'t': 's', 'angle': 'rad', 'p_angle': 'kg m2/s', 'H': 'J'}
    assert run.scene.name == 'swing'
    assert run.title == 'swing, stormer_verlet, h = 0.05 s'
    text = repr(run)
    assert text.startswith(f'Trajectory({run.title}; 41 samples, t = 0 to 2 s, H = ')
    assert '\n' not in text and len(text) < 160


def test_energy_has_the_unit_of_momentum_times_velocity_where_that_is_not_J():
    scene = Scene.build(
        hamiltonian={'kind': 'formula', 'H': 'p_x^2/2 + x^2/2', 'coordinates': [
            {'name': 'x', 'q_unit': 'm', 'p_unit': 'm/s'}]},
        integrator='gauss4', step_size=0.1, initial_state=([1.0], [0.0]))
    found = simulate(scene, 1.0)
    assert found.units['H'] == '(m/s) m/s' and 'H = 0.5 (m/s) m/s, ' in repr(found)
    assert found.plot().axes[-1].get_ylabel() == 'H - H(0) [(m/s) m/s]'


def test_units_of_a_pose_are_those_of_its_parts():
    pose = replace(TURNING, coordinates=(Coordinate('b', 'm', 'kg m/s', 'pose'),)).units
    assert [pose[name] for name in ('b_x', 'b_qw', 'p_b_x', 'p_b_rz')] == [
        'm', '1', 'kg m/s', 'kg m2/s']


def test_one_of_many_is_selected():
    assert np.array_equal(MANY.select(-1).q, 9 * WAVES)
    assert MANY.select(2).alarms == ()
    with refused(IndexError):
        MANY.select(10)
    assert PLAIN.select(0) is PLAIN


def test_length_and_slices_are_of_samples(run):
    part = run[10:31:10]
    assert len(run) == 41 and len(part) == 3 and np.array_equal(part.q, run.q[10:31:10])
    assert all(part.t[0] <= event.t <= part.t[-1] for event in part.events)
    with refused(TypeError):
        run[3]


def test_trajectory_is_a_function_of_time_as_accurate_as_the_method(run):
    times = np.array([[1.7, 0.0], [0.33, run.t[7]]])
    q, p = run(times)
    assert q.shape == p.shape == (2, 2, 1)
    assert q[0, 1] == run.q[0] and q[1, 1] == run.q[7]
    fine = simulate(run.scene, 2.0, step_size=0.0005)
    # Order 2 with h = 0.05: the same error between steps as at them.
    at_steps = np.abs(fine.q[::100] - run.q).max()
    assert abs(q[0, 0] - fine.q[3400]) <= 2.0 * at_steps and run(0.5)[0].shape == (1,)
    assert np.array_equal(run[20:](0.33)[0], q[1, 0])


def test_one_of_many_is_a_function_of_time_from_its_own_start(run):
    many = simulate_many(run.scene.changed({'events': []}), [[0.3], [0.9]], [[0.0], [0.1]], 1.0,
                         samples=20)
    q, _ = many.select(1)(many.t)
    assert np.allclose(q, many.q[:, 1], rtol=1e-12, atol=1e-12)


def test_time_outside_and_run_that_cannot_be_repeated_are_refused(run):
    for broken, t in ((run, 2.1), (run, -0.1), (run, []), (replace(run, q=run.q + 0.1), 1.0),
                      (replace(run, scene=None), 1.0), (MANY, 1.0)):
        with refused(ValueError):
            broken(t)


def test_saved_trajectory_is_loaded_whole(run, tmp_path):
    many = simulate_many(run.scene.changed({'events': []}), [[0.3], [0.9]], [[0.0], [0.1]], 1.0)
    damped = simulate(run.scene, 1.0, effects=[{'kind': 'damping', 'rate': 0.1}])
    for number, whole in enumerate((run, many, damped, PLAIN)):
        whole.save(tmp_path / f'{number}.safetensors')
        same = Trajectory.load(tmp_path / f'{number}.safetensors')
        assert repr(same) == repr(whole) and same.alarms == whole.alarms
        assert [str(event) for event in same.events] == [str(event) for event in whole.events]
        assert all(np.array_equal(getattr(same, name), getattr(whole, name), equal_nan=True)
                   for name in ('t', 'q', 'p', 'energy') + ('work',) * (whole.work is not None))
    assert np.array_equal(Trajectory.load(tmp_path / '0.safetensors')(0.7), run(0.7))
    (tmp_path / 'text').write_text('t,q\n')
    save_file({'t': np.zeros(3)}, tmp_path / 'deep', {'trajectory': 200_000 * '[', 'scene': ''})
    (tmp_path / 'bag').mkdir()
    (tmp_path / 'bag/metadata.yaml').touch()
    for name in ('text', 'none', 'deep', 'bag'):
        with refused(RecordingError):
            Trajectory.load(tmp_path / name)


def test_energy_balance_of_a_part_begins_at_its_first_sample():
    scene = load_scene('damped_pendulum')
    whole = simulate(scene, 2.0)
    late = simulate(scene, 2.0, times=np.array([1.0, 1.5, 2.0]))
    for part in (whole[100:], late):
        assert np.abs(part.balance()).max() <= 2.0 * np.abs(whole.balance()).max()


def test_plot_has_labelled_axes_with_units_and_the_samples(run):
    figure = run.plot()
    assert [axes.get_ylabel() for axes in figure.axes] == [
        'angle [rad]', 'p_angle [kg m²/s]', 'H - H(0) [J]']
    assert figure.axes[-1].get_xlabel() == 't [s]'
    assert np.array_equal(figure.axes[0].lines[0].get_ydata(), run.q[:, 0])
    # The event is a line in every panel, and is named once.
    assert len(run.events) == 1
    assert all(axes.lines[1].get_xdata() == [run.events[0].t] * 2 for axes in figure.axes)
    assert figure.axes[0].get_legend().get_texts()[1].get_text() == 'event angle = 0'


def test_plot_of_a_method_with_internal_steps_is_smooth_between_its_samples():
    """Three samples a period would be a triangle; the picture has the error of dop853."""
    swing = simulate(load_scene('exact_pendulum'), 20.0, step_size=2.0, integrator='dop853',
                     initial_state=([1.0], [0.0]))
    fine = simulate(load_scene('exact_pendulum'), 20.0, integrator='gauss16', step_size=0.05,
                    initial_state=([1.0], [0.0]))
    line = swing.plot().axes[0].lines[0]
    assert len(swing) == 11 and len(line.get_xdata()) >= 500
    assert np.abs(fine(line.get_xdata())[0][:, 0] - line.get_ydata()).max() < 1e-5
    # With commands, the samples are all that is known.
    held = simulate(load_scene('exact_pendulum'), 4.0, step_size=2.0, integrator='dop853',
                    effects=[{'kind': 'external_force', 'coordinates': ['angle'], 'timeout': 9.0}],
                    commands=np.ones((2, 1)))
    assert len(held.phase_portrait(['angle']).axes[0].lines[0].get_xdata()) == 3


def test_plot_has_a_panel_for_each_unit_and_names_every_curve():
    figure = PLAIN.plot()
    assert [axes.get_ylabel() for axes in figure.axes] == [
        'q [m]', 'turn [rad]', 'p [kg m/s]', 'p_turn [kg m²/s]', 'H - H(0) [J]']
    assert [text.get_text() for text in figure.axes[0].get_legend().get_texts()] == ['x', 'y']
    assert len(PLAIN.plot(['y']).axes) == 3
    with refused(ValueError):
        PLAIN.plot(['z'])


def test_plot_of_many_shades_them_and_names_the_first_and_the_last():
    axes = MANY.plot(['x']).axes[0]
    assert len(axes.lines) == 10 > MOST_NAMED
    # Lighter from each to the next: the order is seen in grey, too.
    shades = [lightness(line.get_color()) for line in axes.lines]
    assert (np.diff(shades) > 0.0).all()
    assert [text.get_text() for text in axes.get_legend().get_texts()] == [
        'trajectory 0', '... trajectory 9']


def test_colours_differ_in_lightness_which_grey_and_colour_blind_readers_see():
    # Two CIE units are just seen side by side; thin lines apart from each other take ten times.
    for one, other in combinations(COLOURS, 2):
        assert abs(lightness(one) - lightness(other)) > 20.0
    assert ALARM in COLOURS


def test_plot_of_up_to_eight_curves_gives_each_a_colour_of_its_own():
    axes = Figure().subplots()
    draw_curves(axes, [(str(k), np.arange(2.0), np.arange(2.0)) for k in range(MOST_NAMED)])
    assert len({line.get_color() for line in axes.lines}) == MOST_NAMED


@pytest.mark.filterwarnings('ignore::hnn_vi_ros.errors.AlarmWarning')
def test_alarms_of_a_plot_are_numbered_above_each_other():
    run = simulate('pendulum', 8.0, step_size=0.4, integrator='rk4')
    rows = run.plot().axes
    assert len(run.alarms) > 1
    numbers = [text for text in rows[0].texts if text.get_text().isdigit()]
    assert [text.get_text() for text in numbers] == [str(k + 1) for k in range(len(run.alarms))]
    # Two numbers differ in time by more than their width, or in height.
    places = [(round(text.xy[0] / 0.24), text.get_position()[1]) for text in numbers]
    assert len({*places}) == len(places)
    shown = [text.get_text() for text in rows[-1].get_legend().get_texts()][1:]
    assert shown == [f'{k} alarm: {alarm.kind}' for k, alarm in enumerate(run.alarms, 1)]


def test_portrait_has_momentum_over_coordinate_and_level_sets_of_H(run):
    axes, = run.phase_portrait().axes
    assert (axes.get_xlabel(), axes.get_ylabel()) == ('angle [rad]', 'p_angle [kg m²/s]')
    assert np.array_equal(axes.lines[0].get_xydata(), np.hstack([run.q, run.p]))
    levels = axes.collections[0].get_segments()
    energies = [run.hamiltonian().energy(line[:, :1], line[:, 1:]) for line in levels]
    # H along each line is one value, but for the grid on which it was looked for.
    assert max(np.ptp(energy) for energy in energies) < 0.01 * max(map(np.max, energies))


def test_portraits_of_several_coordinates_stand_side_by_side():
    assert [axes.get_xlabel() for axes in PLAIN.phase_portrait().axes] == [
        'x [m]', 'y [m]', 'turn [rad]']
    assert len(MANY.phase_portrait(['x']).axes[0].lines) == 10
    with refused(ValueError):
        TURNING.phase_portrait()


def test_recording_for_rerun_holds_the_samples_and_the_events(run, tmp_path):
    run.to_rerun(str(tmp_path / 'run.rrd'))
    found = read(tmp_path / 'run.rrd')
    q = found['/state/q']
    assert np.ravel(q['Scalars:scalars']).tolist() == run.q[:, 0].tolist()
    assert q['step'] == list(range(41))
    assert len(found['/events']['step']) == 1 and '/world/bob' in found
    with refused(ValueError):
        PLAIN.to_rerun(tmp_path / 'plain.rrd')


def test_dataframe_has_a_column_each_and_the_units(run):
    pytest.importorskip('pandas', reason='pandas is not installed; see `make test`')
    frame = run.to_dataframe()
    assert list(frame.columns) == ['angle', 'p_angle', 'H'] and frame.index.name == 't'
    assert frame.attrs['units']['p_angle'] == 'kg m2/s'
    assert np.array_equal(frame['angle'], run.q[:, 0])
    many = MANY.to_dataframe()
    assert np.array_equal(many.loc[3, 'x'], MANY.q[:, 3, 0])


def test_dataset_has_dimensions_and_units():
    pytest.importorskip('xarray', reason='xarray is not installed; see `make test`')
    data = MANY.to_xarray()
    assert data['x'].dims == ('t', 'trajectory') and data['x'].attrs == {'units': 'm'}
    assert np.array_equal(data['x'].sel(trajectory=3), MANY.q[:, 3, 0])
    assert PLAIN.to_xarray()['H'].dims == ('t',)


@pytest.mark.parametrize('package, call', [
    ('matplotlib', Trajectory.plot), ('matplotlib', Trajectory.phase_portrait),
    ('pandas', Trajectory.to_dataframe), ('xarray', Trajectory.to_xarray)])
def test_package_that_is_not_installed_is_named_in_one_line(package, call, monkeypatch):
    monkeypatch.setitem(sys.modules, package, None)
    with pytest.raises(MissingPackage, match=f'-m pip install "{package}"') as caught:
        call(PLAIN)
    assert '\n' not in str(caught.value)


def test_plot_shows_what_the_work_of_effects_leaves_of_the_energy():
    run = simulate('exact_damped_driven_pendulum', 1.005, every=10)
    # The last sample lies between two steps, where the work is not known.
    assert np.isfinite(run.work[:-1]).all() and math.isnan(run.work[-1])
    axes = run.plot().axes
    assert [panel.get_ylabel() for panel in axes[-2:]] == ['H - H(0) [J]', 'H - H(0) - W [J]']
    energy, work = axes[-2].lines
    assert np.array_equal(work.get_xdata(), run.t[:-1])
    left, = axes[-1].lines
    assert np.array_equal(left.get_ydata(), run.balance())
    # A method of order 2 at 0.01 s, against a change by joules.
    assert np.abs(run.balance()).max() < 1e-2 < 0.1 * np.abs(energy.get_ydata()).max()
    assert 'of which the work of effects leaves ' in repr(run)
    assert simulate('exact_pendulum', 0.1).work is None


@pytest.mark.parametrize('energy, work, told', [
    (1.0 + 0.01 * T, 0.009 * T, '10 % unexplained; halve step_size'),
    (1.0 + 0.01 * T, 0.00999 * T, '0.1 % unexplained'),
    # Rounding errors, and no sample after the first whose work is known.
    (1.0 + 1e-16 * T, 0.0 * T, None), (1.0 + 0.01 * T, np.where(T > 0.0, math.nan, 0.0), None)])
def test_summary_tells_the_share_of_the_change_of_energy_that_work_leaves(energy, work, told):
    last = replace(PLAIN, energy=energy, work=work).facts()[2]
    assert last.endswith(told) if told else 'unexplained' not in last
