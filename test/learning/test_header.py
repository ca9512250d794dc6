# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Coordinates, velocities and forces are found by the names of columns, keys and joints."""

from pathlib import Path

from bag_files import state, write
from hnn_vi_ros.errors import DataError
from hnn_vi_ros.identify.check import check
from hnn_vi_ros.learning import read_motions, source_of
from hnn_vi_ros.learning.data.header import read_header
from hnn_vi_ros.learning.data.text import _rows
from hnn_vi_ros.learning.data.units import conversion, split_unit
from hnn_vi_ros.learning.families.priors import PlanarChain
from hnn_vi_ros.learning.fit.config import guess_config, load_config
from hnn_vi_ros.models import chain_angles
from hnn_vi_ros.phase_space import Coordinate
from messages import refused
import numpy as np
import pytest

T = 0.02 * np.arange(200)


def log(path: Path, header: str) -> Path:
    """Write a log whose columns are times and sinusoids."""
    columns = [T, *(np.sin((1.3 + k) * T + k) for k in range(header.count(',')))]
    np.savetxt(path, np.stack(columns, axis=-1), '%.6f', ',', header=header, comments='')
    return path


@pytest.mark.parametrize('name, base, unit', [
    ('angle [deg]', 'angle', 'deg'), ('theta_deg', 'theta', 'deg'), ('x_mm', 'x', 'mm'),
    ('rate_deg_s', 'rate', 'deg/s'), ('Ang. Vel. (°/s)', 'Ang. Vel.', '°/s'),
    ('Motor Torque Nm', 'Motor Torque', 'Nm'), ('a [m/s²]', 'a', 'm/s²'), ('q1', 'q1', ''),
    ('Angle/deg', 'Angle', 'deg'), ('time_ms_rel', 'time', 'ms'), ('Zeit in s', 'Zeit', 's'),
    ('angle (left)', 'angle (left)', ''), ('v_m_per_s', 'v', 'm/s'), ('a_m_s2', 'a', 'm/s2'),
    ('x [mm^-200]', 'x [mm^-200]', ''), ('x [ns^-99]', 'x [ns^-99]', ''),
    ('x [ns^-9]', 'x', 'ns^-9')])
def test_name_is_split_from_its_unit(name, base, unit):
    assert split_unit(name) == (base, unit)


@pytest.mark.parametrize('unit, target, factor', [
    ('mm', 'm', 1e-3), ('deg/s', 'rad/s', np.pi / 180.0), ('rpm', 'rad s-1', np.pi / 30.0),
    ('kgf·cm', 'N m', 0.0980665), ('ozf in', 'N m', 7.0615518e-3), ('lbf', 'N', 4.4482216),
    ('N·mm', 'N m', 1e-3), ('mm/s', 'cm/s', 0.1), ('kg m2/s', 'N m s', 1.0), ('mm', 'rad', None),
    ('px', 'm', None), ('furlong', 'm', None)])
def test_units_of_one_quantity_are_converted(unit, target, factor):
    assert conversion(unit, target) == (factor if factor is None else pytest.approx(factor))


@pytest.mark.parametrize('header, coordinates, v, tau', [
    ('t,q1,q2,dq1,dq2,tau1,tau2', 'q1 rad q2 rad', 'dq1 dq2', 'tau1 tau2'),
    ('stamp,theta,thetadot,u', 'theta rad', 'thetadot', 'u'),
    ('t,x,theta,force', 'x m theta rad', '', 'force'),
    ('t,theta,x,omega,v', 'x m theta rad', 'v omega', ''),
    ('time,shoulder_pos,elbow_pos,shoulder_vel,elbow_vel,shoulder_effort,elbow_effort',
     'shoulder rad elbow rad', 'shoulder_vel elbow_vel', 'shoulder_effort elbow_effort'),
    ('t,/js/joint_a/position,/js/joint_b/position,/js/joint_b/velocity,/js/joint_a/velocity',
     'js_joint_a rad js_joint_b rad', '/js/joint_a/velocity /js/joint_b/velocity', ''),
    ('t,q,tau_cmd,tau,q_des', 'q rad', '', 'tau'), ('t,x [px],v', 'x px', 'v', ''),
    ('t,displacement_mm,acc,u_V', 'displacement m', '', 'u_V'),
    ('t,angle,p_angle,H', 'angle rad', '', ''), ('t,θ,ω', 'θ rad', 'ω', ''),
    ('t,motorAngle,motorTorque', 'motor rad', '', 'motorTorque')])
def test_columns_are_found_by_their_names_and_the_printed_yaml_is_the_configuration(
        tmp_path, header, coordinates, v, tau):
    config, text = guess_config([str(log(tmp_path / 'log.csv', header))])
    assert ' '.join(f'{one.name} {one.q_unit}' for one in config.coordinates) == coordinates
    assert ' '.join(config.data.v or ()) == v
    assert ' '.join(config.data.tau or ()) == tau
    (tmp_path / 'config.yaml').write_text(text)
    assert load_config(tmp_path / 'config.yaml') == config


@pytest.mark.parametrize('header, unit, numbers', [
    ('t,x_mm,u_V', 'V s', 'V s2/m V V/m V/m2'),
    ('t,theta,current [A]', 'A s', 'A s2 A A/rad A A/rad2 rad'),
    ('t,theta,tau [Nm]', 'N m s', 'kg m2 N m N m/rad N m N m/rad2 rad'),
    ('t,x [m],theta [rad],F [N]', 'N s N m s',
     'kg kg m2 kg m N N m N/m N m/rad N/rad N m N/m2 N m/rad2 rad')])
def test_numbers_have_the_unit_of_the_commands(tmp_path, header, unit, numbers):
    coordinates = guess_config([str(log(tmp_path / 'log.csv', header))])[0].coordinates
    units = [one.p_unit for one in coordinates]
    assert ' '.join(units) == unit
    chain = PlanarChain(chain_angles([one.kind for one in coordinates])[0], 1.0, 2, True)
    assert ' '.join(one.unit for one in chain.quantities(units).values()) == numbers


@pytest.mark.parametrize('header', [
    't,q,dq', 't,ch1', 't,theta,omega,rate', 't,status,a,b',
    'x,y', 't,encoder [counts]'])
def test_header_that_is_not_clear_is_refused_in_a_line(tmp_path, header):
    with refused(DataError):
        read_header(log(tmp_path / 'log.csv', header))


SCENE = [Coordinate('angle', 'rad', 'N m s'), Coordinate('x', 'm', 'N s')]


def test_log_is_parsed_once_for_its_columns_and_for_its_motions(tmp_path):
    paths = [str(log(tmp_path / f'{name}.csv', 't,theta_deg')) for name in 'ab']

    def by_train():
        config, _ = guess_config(paths)
        config.motions(tmp_path, ['theta'], paths)

    def by_scene():
        source = source_of(paths[0], SCENE[:1])
        read_motions(tmp_path, source, ['angle'], paths, ['rad'])
    for read in (by_train, by_scene, lambda: check(paths)):
        _rows.cache_clear()
        read()
        assert _rows.cache_info().misses == len(paths)
    (tmp_path / 'a.csv').write_text((tmp_path / 'b.csv').read_text().replace('theta_deg', 'phi'))
    assert read_header(tmp_path / 'a.csv').q[0].name == 'phi'


@pytest.mark.parametrize('header, coordinates, q, v, tau', [
    ('t,theta_deg', SCENE[:1], 'theta_deg', None, None), ('t,q,dq', SCENE[:1], 'q', 'dq', None),
    ('t,ch1', SCENE[:1], 'ch1', None, None), ('t,x,angle', SCENE, 'angle x', None, None),
    ('t,x_mm,angle,force', SCENE, 'angle x_mm', None, 'force'),
    ('t,/joint_states/angle/position,/joint_states/base/position', SCENE[:1],
     '/joint_states/angle/position', None, None),
    ('t,/js/angle/effort,/js/x/position,/js/angle/velocity,/js/angle/position,/js/x/velocity',
     SCENE, '/js/angle/position /js/x/position', '/js/angle/velocity /js/x/velocity',
     '/js/angle/effort'),
    ('t,/js/base/effort,/js/base/position,/js/base/velocity,/js/angle/effort,/js/angle/position,'
     '/js/angle/velocity', SCENE[:1], '/js/angle/position', '/js/angle/velocity',
     '/js/angle/effort'),
    ('t,base_pos,base_vel,angle_pos,angle_vel', SCENE[:1], 'angle_pos', 'angle_vel', None),
    ('t,base_pos,base_vel,angle_pos', SCENE[:1], 'angle_pos', None, None)])
def test_columns_are_those_of_the_coordinates_of_a_scene(
        tmp_path, header, coordinates, q, v, tau):
    path = log(tmp_path / 'log.csv', header)
    data = source_of(str(path), coordinates)
    names = [' '.join(names) if names else None for names in (data.q, data.v, data.tau)]
    assert names == [q, v, tau]


@pytest.mark.parametrize('header, time', [
    ('__time,/js/header/stamp,/js/joint_a/position', '/js/header/stamp'),
    ('__time,/imu/header/stamp,/js/joint_a/position', '__time'),
    ('t,header.stamp,theta', 'header.stamp')])
def test_stamp_in_the_header_of_the_topic_comes_before_the_clock_of_a_receiver(
        tmp_path, header, time):
    path = tmp_path / 'log.csv'
    np.savetxt(path, np.stack([T + 1e-3 * np.sin(9.0 * T), T, np.sin(T)], axis=-1), '%.6f', ',',
               header=header, comments='')
    assert read_header(path).time.name == time


def test_joint_states_are_in_rad_and_m_whatever_their_range(tmp_path):
    path = tmp_path / 'log.csv'
    np.savetxt(path, np.stack([T, 12.0 * np.sin(T), 12.0 * np.cos(T)], axis=-1), '%.6f', ',',
               header='t,/joint_states/elbow/position,/joint_states/slider/position', comments='')
    found = read_header(path)
    assert [(one.name, one.kind) for one in found.q] == [
        ('/joint_states/slider/position', 'm'), ('/joint_states/elbow/position', 'rad')]


@pytest.mark.parametrize('header', ['t,theta,phi', 't,x_mm', 't,angle'])
def test_columns_that_are_not_those_of_the_scene_are_refused(tmp_path, header):
    path = log(tmp_path / 'log.csv', header)
    with refused(DataError):
        read_motions(path, source_of(str(path), SCENE[:1] if header != 't,angle' else SCENE),
                     ['angle'], [str(path)], ['rad'])


def test_joints_of_bags_and_arrays_tell_their_kind_or_are_refused(tmp_path):
    for name in ('elbow', 'lift'):
        bag = write(tmp_path / f'{name}.mcap', [
            state(t + 1.0, [name], [np.sin(t)], [np.cos(t)], [0.0]) for t in T])
        if name == 'elbow':
            config, _ = guess_config([str(bag)])
            assert config.motions(tmp_path, ['elbow'], [])[0][0].q.shape[1] == 1
        else:
            with refused(DataError):
                guess_config([str(bag)])
    np.savez(tmp_path / 'a.npz', t=T, q=np.zeros((200, 2)))
    with refused(DataError):
        guess_config([str(tmp_path / 'a.npz')])
