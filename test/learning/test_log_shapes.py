# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""One log in many shapes: each is read as it is meant, or refused with the data that read it."""

from collections.abc import Callable, Sequence
from io import BytesIO
from pathlib import Path
import sys

from hnn_vi_ros.errors import DataError
from hnn_vi_ros.identify import arguments as identify
from hnn_vi_ros.learning import arguments, EvenMotion, read_motions
from hnn_vi_ros.learning.data.header import read_header
from hnn_vi_ros.learning.data.sources import configuration_of, source_of
from hnn_vi_ros.learning.data.text import LogMotions
from hnn_vi_ros.learning.data.units import split_unit
from messages import refused
import numpy as np
import pandas as pd
import pytest
from python_process import run_code
from scipy.integrate import solve_ivp
from scipy.interpolate import CubicSpline
from scipy.io import savemat
import yaml

NOISE = 2e-3
T = 0.05 * np.arange(401)
SWING = solve_ivp(lambda _, y: [y[1], -14.0 * np.sin(y[0]) - 0.05 * y[1]], (0.0, T[-1]),
                  [0.95, 0.0], 'DOP853', T, rtol=1e-10, atol=1e-12).y
Q = SWING[0] + NOISE * np.random.default_rng(0).normal(size=len(T))
V, DEG, TURNING = SWING[1], np.degrees(Q), 5.0 * Q
U = np.sin(3.0 * T)
# Times of a slow, busy logger, and of one with a clock that jitters by a fifth of the interval.
RANDOM = np.sort(np.random.default_rng(1).uniform(0.0, 20.0, len(T)))
JITTERING = np.sort(T + np.random.default_rng(2).normal(0.0, 0.01, len(T)))
AT_RANDOM = np.random.default_rng(5).normal(size=len(T))
AT = np.random.default_rng(1).permutation(np.arange(5, len(T) - 5))


def rows(*columns: Sequence[object], head: str = 't,theta', mark: str = ',', end: str = '\n',
         form: str = '{:.5f}') -> str:
    """Return the text of a log."""
    lines = [mark.join(one if isinstance(one, str) else form.format(one) for one in row)
             for row in zip(*columns, strict=True)]
    return end.join([*([head] if head else []), *lines, ''])


def put(values: np.ndarray, at: np.ndarray, wrong: object) -> list[object]:
    """Return values with others at some places."""
    found = values.tolist()
    for i in at:
        found[i] = wrong(found[i]) if callable(wrong) else wrong
    return found


def at(t: np.ndarray) -> np.ndarray:
    """Return what the sensor gives at some times."""
    return CubicSpline(T, SWING[0])(t) + NOISE * np.random.default_rng(3).normal(size=len(t))


def comma(values: np.ndarray, quote: str = '') -> list[str]:
    return [f'{quote}{value:.5f}{quote}'.replace('.', ',') for value in values]


def stamps(size: float, first: int = 1692089273) -> list[list[str]]:
    """Return whole seconds and the rest in units of this size [s]."""
    return [[f'{first + t // 1:.0f}' for t in T], [f'{(t % 1.0) / size:.0f}' for t in T]]


def clock(t: float) -> str:
    """Return the time of day that is 5 s before midnight at 0."""
    return f'23:59:{55.0 + t:08.5f}' if t < 4.999 else f'00:00:{t - 5.0:08.5f}'


def counts(per_turn: float) -> list[str]:
    return [f'{round(q / (2.0 * np.pi) * per_turn)}' for q in Q]


def wrapped(values: np.ndarray, low: float, turn: float) -> np.ndarray:
    return (values - low) % turn + low


# Text or bytes, and the angle that is meant.
READ: dict[str, Callable[[], tuple[str | bytes, np.ndarray]]] = {
    'plain': lambda: (rows(T, Q), Q),
    'degrees in the name': lambda: (rows(T, DEG, head='time,theta_deg'), Q),
    'degree sign of UTF-8': lambda: (rows(T, DEG, head='t,angle (°)'), Q),
    'byte order mark': lambda: ('\ufeff' + rows(T, Q), Q),
    'nanoseconds': lambda: (rows(1e9 * T, Q, head='stamp_ns,theta'), Q),
    'seconds and nanoseconds of ROS': lambda: (
        rows([f'{1692089273 + t // 1:.0f}' for t in T], [f'{1e9 * (t % 1.0):.0f}' for t in T], Q,
             head='header.stamp.sec,header.stamp.nanosec,theta'), Q),
    'nanoseconds beside words': lambda: (
        rows([f'{1692089273 * 10**9 + round(1e9 * t)}' for t in T], ['joint1'] * len(T), Q,
             head='time,name,theta'), Q),
    'stamps since 1970 in ms': lambda: (rows(1.7e12 + 1e3 * T, Q, head='stamp,theta'), Q),
    'ts': lambda: (rows(1.7e12 + 1e3 * T, Q, head='ts,theta'), Q),
    'semicolons and decimal commas': lambda: (rows(comma(T), comma(Q), mark=';',
                                                   head='t;theta'), Q),
    'quoted decimal commas': lambda: (rows(comma(T, '"'), comma(Q, '"')), Q),
    'tabs and decimal commas': lambda: (rows(comma(T), comma(Q), mark='\t', head='t\ttheta'), Q),
    'spaces': lambda: (rows(T, Q, mark='   ', head='t   theta'), Q),
    'carriage returns': lambda: (rows(T, Q, end='\r\n'), Q),
    'trailing separators': lambda: (rows(T, Q, [''] * len(T), head='t,theta,'), Q),
    'empty lines': lambda: (rows(T, Q, end='\n\n'), Q),
    'header in a comment': lambda: (rows(T, Q, head='# t theta', mark=' '), Q),
    'text above': lambda: ('Logger 2.1\nRate:,100\n\n' + rows(T, Q), Q),
    'units in a row of brackets': lambda: (rows(T, DEG, head='t,angle\n[s],[°]'), Q),
    'sentinels': lambda: (rows(T, put(DEG, AT[:26], -999.0), head='t,theta_deg'), Q),
    'glitches': lambda: (rows(T, put(Q, AT[:9], lambda q: q + 2.9)), Q),
    'words for nothing': lambda: (rows(T, put(Q, AT[:9], 'NaN')), Q),
    'stuck': lambda: (rows(T, np.where((T > 5.0) & (T < 5.4), Q[101], Q), form='{:.6f}'), Q),
    'held': lambda: (rows(0.01 * np.arange(5 * len(T)), np.repeat(Q, 5)), Q),
    'truncated': lambda: (rows(T, Q)[:-6], Q),
    'truncated after a line': lambda: (rows(T, Q) + '2', Q),
    'no last line end': lambda: (rows(T, Q)[:-1], Q),
    'times that come twice': lambda: (rows(*np.repeat([T, Q], np.where(T == 5.0, 2, 1), 1)), Q),
    'late samples': lambda: (rows(put(T, AT[:5], lambda t: t - 1.0), Q), Q),
    'gap': lambda: (rows(*np.array([T, Q])[:, (T < 5.0) | (T > 5.3)]), Q),
    'random times': lambda: (rows(RANDOM, at(RANDOM)), Q),
    'jittering clock': lambda: (rows(JITTERING, at(JITTERING)), Q),
    'two rates': lambda: ((lambda t: rows(t, at(t)))(np.concatenate(
        [T[:200], 10.0 + 0.02 * np.arange(500)])), Q),
    'filtered beside measured': lambda: (rows(T, Q, 0.9 * Q, head='t,theta,theta_filtered'), Q),
    'index of pandas': lambda: (rows([f'{k}' for k in range(len(T))], T, Q, head=',t,theta'), Q),
    'zeros in place of values': lambda: (rows(T, put(Q, AT[:26], 0.0)), Q),
    'sentinels of a force': lambda: (rows(T, Q, V, put(U, AT[:9], -999.0),
                                          head='t,theta,omega,tau'), Q),
    'wrapped at 360 degrees': lambda: (rows(T, wrapped(np.degrees(TURNING), 0.0, 360.0),
                                            head='t,angle [deg]'), TURNING),
    'wrapped at pi': lambda: (rows(T, wrapped(TURNING, -np.pi, 2.0 * np.pi)), TURNING),
    'constant columns': lambda: (rows(T, Q, 0.0 * T, 0.0 * T + 3.0,
                                      head='t,theta,phi,temperature'), Q),
    'text columns': lambda: (rows(T, Q, ['ok'] * len(T), head='t,theta,status'), Q),
    'velocity': lambda: (rows(T, Q, V, head='t,theta,omega'), Q),
    'millimetres': lambda: (rows(T, 1e3 * Q, head='t,x_mm'), Q),
    'stamps of other words': lambda: (rows(*stamps(1e-9), Q, head='secs,nsecs,theta'), Q),
    'seconds and microseconds': lambda: (rows(*stamps(1e-6), Q, head='sec,usec,theta'), Q),
    'seconds, nanoseconds': lambda: (rows(*stamps(1e-9), Q, head='seconds,nanoseconds,theta'), Q),
    'the same time twice': lambda: (rows(T, 1e3 * T, Q, head='sec,msec,theta'), Q),
    'dates of ISO': lambda: (rows([f'2026-01-01T10:00:{t:08.5f}Z' for t in T], Q), Q),
    'dates with a space': lambda: (rows([f'2026-01-01 10:00:{t:08.5f}' for t in T], Q), Q),
    'American dates': lambda: (rows([f'1/31/2026 10:00:{t:08.5f} PM' for t in T], Q), Q),
    'German dates, hours, commas': lambda: (rows(
        [f'{1 + (t > 4.99):02}.02.2026' for t in T], [*map(clock, T)], comma(DEG), mark=';',
        head='Datum;Zeit;Winkel [Grad]'), Q),
    'Date, Time': lambda: (rows([f'2026-01-{1 + (t > 4.99):02}' for t in T], [*map(clock, T)], Q,
                                head='Date,Time,theta'), Q),
    'time of day': lambda: (rows([f'10:00:{t:08.5f}' for t in T], Q, head='time,theta'), Q),
    'German': lambda: (rows(T, DEG, np.degrees(V),
                            head='Zeit [s],Winkel [Grad],Winkelgeschwindigkeit [Grad/s]'), Q),
    'French': lambda: (rows(T, DEG, head='temps (s),angle (degrés)'), Q),
    'French without accents': lambda: (rows(T, DEG, head='temps (s),angle (degre)'), Q),
    'Spanish': lambda: (rows(T, DEG, head='tiempo (s),ángulo (grados)'), Q),
    'Italian': lambda: (rows(T, DEG, head='tempo [s],angolo [gradi]'), Q),
    'Dutch': lambda: (rows(T, DEG, head='tijd [s],hoek [graden]'), Q),
    'small angle in Grad': lambda: (rows(T, 0.05 * DEG, head='t,Winkel [Grad]'), 0.05 * Q),
    'PlotJuggler': lambda: (rows(T + 1.7e9, Q, V, head=(
        '__time,/joint_states/elbow/position,/joint_states/elbow/velocity')), Q),
    'topics without a slash': lambda: (rows(T, Q, head='__time,joint_states/elbow/position'), Q),
    'fields of PlotJuggler': lambda: (rows(T, Q, V, head=(
        '__time,/joint_states/position[0],/joint_states/velocity[0]')), Q),
    'PASCO': lambda: (rows(T, Q, V, head=(
        'Time (s) Run #1,Angle (rad) Run #1,Angular Velocity (rad/s) Run #1')), Q),
    'PASCO Capstone': lambda: (rows(T, DEG, head=(
        '"Run #1","Run #1"\n"Time (s)","Angle, Ch P1 (°)"')), Q),
    'Vernier': lambda: (rows(T, Q, head='Latest: Time (s),Latest: Angle (rad)'), Q),
    'counts per turn above': lambda: (rows(T, counts(2000), head=(
        '# counts per turn: 2000\nt,encoder [counts]')), Q),
    'ticks': lambda: (rows(T, counts(4096), head='counts_per_rev = 4096\nt,ticks'), Q),
    'gear': lambda: (rows(T, counts(50 * 2000), U, head=(
        'Gear ratio;1:50\nCPR;2000\nTorque constant [mNm/A];50\nt;encoder;current [A]'),
        mark=';'), Q),
    'joint states': lambda: (rows(
        T, Q, V, U, head='/time,/joint_states/arm/position,/joint_states/arm/velocity,'
        '/joint_states/arm/effort'), Q),
    'stamps beside times of PlotJuggler': lambda: (rows(T + 1.7e9, T + 1.7e9, Q, head=(
        '__time,/joint_states/header/stamp,/joint_states/arm/position')), Q),
    'stamps since 1970 in microseconds': lambda: (rows(
        [f'{1692089273 * 10**6 + round(1e6 * t)}' for t in T], Q, head='timestamp_us,theta'), Q),
    'data set of Vernier': lambda: (rows(T, DEG, head=(
        '"Data Set 1:Time(s)","Data Set 1:Angle(°)"')), Q),
    'Logger Pro': lambda: (
        'Vernier Format 2\nuntitled.cmbl 1/1/2026 10:00:00 .\nLatest\nTime\tAngle\nt\tA\n'
        's\trad\n\n' + rows(T, Q, head='', mark='\t'), Q),
    'German Excel': lambda: ('sep=;\n' + rows(
        comma(T), comma(DEG), comma(np.degrees(V)), mark=';', end='\r\n',
        head='Zeit in s;Winkel in °;Winkelgeschwindigkeit in °/s'), Q),
    'French Excel': lambda: ('\ufeff' + rows(
        comma(T), comma(DEG), comma(np.degrees(V)), mark=';', end='\r\n',
        head='Temps (s);Angle (°);Vitesse angulaire (°/s)'), Q),
    'German phyphox': lambda: (rows(comma(T), comma(DEG), mark='\t', head=(
        '"Zeit (s)"\t"Winkel (°)"')), Q),
    'frames of OptiTrack': lambda: ('Format Version,1.23,Take Name,a\n\n' + rows(
        [f'{k}' for k in range(len(T))], T, Q, head='Frame,Time (Seconds),Rotation (rad)'), Q),
    'units in a row': lambda: (rows(T, DEG, head='Time,Angle\ns,deg'), Q),
    'numbers in quotes': lambda: (rows(*([f'"{x:.5f}"' for x in column] for column in (T, Q)),
                                       head='"t","theta"'), Q),
}
# Logs with two readings: the message has the data of the one that is meant.
DOUBTFUL: dict[str, Callable[[], tuple[str, np.ndarray]]] = {
    'without a header': lambda: (rows(T, Q, head=''), Q),
    'degrees without a unit': lambda: (rows(T, DEG), Q),
    'wrapped at 180 degrees': lambda: (rows(T, wrapped(np.degrees(TURNING), -180.0, 360.0)),
                                       TURNING),
    'wrapped at two pi': lambda: (rows(T, wrapped(TURNING, 0.0, 2.0 * np.pi)), TURNING),
    'millimetres without a unit': lambda: (rows(T, 1e3 * Q, head='t,x'), Q),
    'angle or length': lambda: (rows(T, Q, head='t,q'), Q),
    'milliseconds without a unit': lambda: (rows(1e3 * T, Q), Q),
    'nanoseconds without a unit': lambda: (rows(1e9 * T, Q), Q),
    'current and torque': lambda: (rows(T, Q, U, V, head='t,theta,current [A],torque [Nm]'), Q),
    'a coordinate twice': lambda: (rows(T, DEG, Q, head='t,theta_deg,theta_rad'), Q),
    'a name twice': lambda: (rows(T, Q, U, head='t,theta,theta'), Q),
}
REFUSED: dict[str, Callable[[], str | bytes]] = {
    'angle of a small swing in degrees': lambda: rows(T, DEG / 11.0),
    'decimal commas between commas': lambda: rows(comma(T), comma(Q)),
    'points and commas': lambda: rows(comma(T), Q, mark=';', head='t;theta'),
    'separators of thousands': lambda: rows(T, [f'"{1e5 * (q + 2):,.1f}"' for q in Q],
                                            head='t,x [mm]'),
    'many glitches': lambda: rows(T, put(Q, AT[:90], lambda q: q + 2.9), head='t,theta [rad]'),
    'stuck at the start': lambda: rows(T, np.where(T < 2.5, Q[50], Q), form='{:.6f}'),
    'cosine': lambda: rows(T, np.cos(Q), head='t,cos_theta'),
    'velocity of another sign': lambda: rows(T, Q, -V, head='t,theta,omega'),
    'JSON': lambda: rows([f'{{"t": {t}, "theta": {q}}}' for t, q in zip(T, Q, strict=True)],
                         head=''),
    'whole seconds': lambda: rows(np.floor(T), Q),
    'two motions in one': lambda: rows(0.01 * np.arange(2 * len(T)), np.concatenate([
        np.sin(0.6 * T), np.sin(0.6 * T + 2.0)])),
    'times that never increase': lambda: rows(T[::-1], Q),
    'two runs side by side': lambda: rows(T, Q, T, 0.5 * Q, head=(
        'Time (s) Run #1,Angle (rad) Run #1,Time (s) Run #2,Angle (rad) Run #2')),
    'rostopic echo -p': lambda: rows([f'{1692089273 * 10**9 + round(1e9 * t)}' for t in T],
                                     ['elbow'] * len(T), Q, head=(
                                         '%time,field.name0,field.position0')),
    'ros2 topic echo --csv': lambda: rows(*stamps(1e-9), [''] * len(T), ['elbow'] * len(T), Q,
                                          head=''),
    'a force of an unknown unit': lambda: rows(T, Q, U, head='t,theta [rad],torque [g cm]'),
    'a force in the unit of a mass': lambda: rows(T, Q, U, head='t,theta [rad],torque [kg cm]'),
    'unknown unit of a small angle': lambda: rows(T, 0.05 * DEG, head='t,angle [foo]'),
    'counts of an unknown turn': lambda: rows(T, counts(4096), head='t,encoder'),
    'dates that are none': lambda: rows([f'2026-13-01 10:00:{t:08.5f}' for t in T], Q),
    'rates alone': lambda: rows(T, V, head='Time (s),Gyroscope x (rad/s)'),
    'temperature': lambda: rows(T, 20.0 + Q, head='t,temperature [C]'),
    'noise': lambda: rows(T, NOISE * AT_RANDOM, head='t,theta [rad]'),
    'noise of a whole turn': lambda: rows(T, np.mod(9.0 * AT_RANDOM, 6.28), head='t,theta [rad]'),
    'quanta of a body at rest': lambda: rows(T, 0.3 + np.round(NOISE * AT_RANDOM, 3),
                                             head='t,theta [rad]'),
    'a constant': lambda: rows(T, 0.0 * Q + 0.3),
    'two bodies in turn': lambda: rows(np.ravel([T, T + 0.02], 'F'), ['a', 'b'] * len(T),
                                       np.ravel([Q, 0.3 * np.cos(2.0 * T)], 'F'),
                                       head='t,name,theta'),
    'two bodies at the same times': lambda: rows(np.repeat(T, 2), np.ravel([Q, -Q], 'F')),
    'a force that is a copy': lambda: rows(T, Q, Q, head='t,theta [rad],torque [Nm]'),
    'a force that is a scaled copy': lambda: rows(
        T, Q, np.round(0.3 * V + 2.0, 4), V, head='t,theta [rad],torque [Nm],omega [rad/s]'),
    'a joint that is a copy': lambda: rows(T, Q, Q, head='t,q1 [rad],q2 [rad]'),
    'no times': lambda: rows(Q, V, head='theta,omega'),
    'a row too short': lambda: rows(T, Q).replace(f'\n{T[9]:.5f},', f'\n{T[9]:.5f};'),
    'a sheet': lambda: b'PK\x03\x04' + bytes(range(256)) * 9,
    'nothing': lambda: 't,theta\n',
    'one column': lambda: rows(T, head=''),
}


TABLE = pd.DataFrame({'timestamp': T, 'theta': Q})
# Files that are no plain text.
FILES: dict[str, Callable[[Path], object]] = {
    'log.parquet': TABLE.to_parquet, 'log.feather': TABLE.to_feather,
    'dates.parquet': lambda path: TABLE.assign(
        timestamp=pd.Timestamp('2026-01-01') + pd.to_timedelta(T, 's')).set_index(
            'timestamp').to_parquet(path),
    'log.json': lambda path: TABLE.to_json(path, orient='records'), 'columns.json': TABLE.to_json,
    'log.csv.gz': lambda path: TABLE.to_csv(path, index=False),
    'log.zip': lambda path: TABLE.to_csv(path, index=False),
    'log.npy': lambda path: np.save(path, TABLE.to_records(index=False)),
    'log.mat': lambda path: savemat(path, {'t': T, 'theta': Q, 'rate': 20.0}),
    'struct.mat': lambda path: savemat(path, {'log': {'t': T, 'theta': Q[:, None]}})}
# First bytes of files that are refused, by their names.
BINARY = {
    'log.npy': b'\x93NUMPY', 'log.mat': b'MATLAB 7.3 MAT-file' + 105 * b' ' + b'\0\2IM',
    'log.mcap.zstd': b'\x28\xb5\x2f\xfd', 'log.bag': b'#ROSBAG V2.0\n', 'log.ulg': b'ULog',
    'log.h5': b'\x89HDF', 'log.pkl': b'\x80\4', 'log.xls': b'\xd0\xcf\x11\xe0',
    'log.zip': b'PK\3\4', 'log.csv.gz': b'\x1f\x8b', 'log.parquet': b'PAR1', 'log.json': b'{'}


def read(path, coordinates=()):
    reading = read_header(path, coordinates)
    data = LogMotions.model_validate(reading.data)
    units = [one['q_unit'] for one in reading.configuration['coordinates']]
    return read_motions(path, data, units, [str(path)], units)


def is_meant(found: Sequence[EvenMotion], expected: np.ndarray) -> bool:
    """Compare motions with the angle that is meant, at the times T."""
    # Six standard deviations, and a cubic spline that bridges 0.45 s of a motion of at most 3.8
    # rad/s of phase: 5 / 384 (0.45 3.8)^4. Wrapped angles begin in any turn, and times anywhere.
    bound = np.ptp(expected) / np.ptp(Q) * (6.0 * NOISE + 5.0 / 384.0 * (0.45 * 3.8)**4)
    for motion in found:
        t = motion.t - (motion.t[0] if motion.t[0] > 1e3 else 0.0)
        error = motion.q[:, 0] - np.interp(t, T, expected)
        error -= 2.0 * np.pi * np.round(error[0] / (2.0 * np.pi))
        if np.abs(error).max() >= bound:
            return False
    return sum(len(motion.t) for motion in found) > 380


@pytest.mark.parametrize('shape', READ)
def test_log_is_read_as_it_is_meant(tmp_path, shape):
    text, expected = READ[shape]()
    path = tmp_path / 'log.csv'
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    assert is_meant(read(path)[0], expected)


@pytest.mark.parametrize('shape', DOUBTFUL)
def test_log_of_two_readings_is_refused_with_the_data_of_one(tmp_path, shape):
    text, expected = DOUBTFUL[shape]()
    path = tmp_path / 'log.csv'
    path.write_text(text)
    with refused(DataError) as caught:
        read(path)
    data = yaml.safe_load(str(caught.value).partition(' data: ')[2])
    unit = 'm' if 'millimetres' in shape else 'rad'
    motions, _ = read_motions(path, LogMotions.model_validate(data), ['x'], [str(path)], [unit])
    assert is_meant(motions, expected)


@pytest.mark.parametrize('name', FILES)
def test_tables_and_compressed_logs_are_read(tmp_path, name):
    FILES[name](tmp_path / name)
    assert is_meant(read(tmp_path / name)[0], Q)


@pytest.mark.parametrize('name', BINARY)
def test_file_that_is_no_log_is_refused_with_a_remedy(tmp_path, name):
    (tmp_path / name).write_bytes(BINARY[name] + 99 * b'\1')
    with refused(DataError):
        read(tmp_path / name)


# Small files of much content: rows of which one column is the last, and blocks of zeros.
HUGE: dict[str, Callable[[Path], object]] = {
    'log.npy': lambda path: path.write_bytes(_header_of(10**15)),
    'log.parquet': lambda path: pd.DataFrame(
        dict.fromkeys('abcd', np.zeros(6_000_000))).to_parquet(path),
    'log.feather': lambda path: pd.DataFrame({'a': np.zeros(10**8)}).to_feather(
        path, compression='zstd'),
    'log.mat': lambda path: savemat(path, {'a': np.zeros(3 * 10**8, np.int8)},
                                    do_compression=True),
    'log.xlsx': lambda path: _sheet(path, 2000)}


def _header_of(rows: int) -> bytes:
    stream = BytesIO()
    np.lib.format.write_array_header_1_0(
        stream, {'descr': '<f8', 'fortran_order': False, 'shape': (rows,)})
    return stream.getvalue()


def _sheet(path: Path, rows: int) -> None:
    openpyxl = pytest.importorskip('openpyxl')
    book = openpyxl.Workbook()
    for row in range(1, rows):
        book.active.cell(row, 16_384, 1.0)
    book.save(path)


@pytest.mark.long
@pytest.mark.parametrize('name', HUGE)
def test_small_file_of_a_huge_table_is_refused_within_the_memory(tmp_path, name):
    path = tmp_path / name
    HUGE[name](path)
    code = ('import resource, sys; from pathlib import Path\n'
            'from hnn_vi_ros.errors import DataError\n'
            'from hnn_vi_ros.learning.data.header import read_header\n'
            'try:\n    read_header(Path(sys.argv[1]), ())\n'
            'except (DataError, OSError) as problem:\n    print(problem)\n'
            'print(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss)')
    found = run_code(code, str(path))
    problem, memory = found.stdout.splitlines()
    assert 'not a readable' in problem, found.stderr
    assert int(memory) < 2_600_000  # [KiB]: what is allowed, and the libraries before it


def test_name_of_many_words_takes_no_time():
    assert split_unit('b ' * 200_000 + 'mm') == ('b ' * 200_000 + 'mm', '')


def test_package_that_a_table_needs_is_named_and_plain_logs_need_none(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, 'pandas', None)
    FILES['log.feather'](tmp_path / 'log.feather')
    with refused(DataError):
        read(tmp_path / 'log.feather')
    for name in ('log.csv.gz', 'log.mat'):
        FILES[name](tmp_path / name)
        assert is_meant(read(tmp_path / name)[0], Q)


def test_currents_are_torques_and_counts_angles_of_the_joint_behind_a_gear(tmp_path):
    (tmp_path / 'log.csv').write_text(READ['gear']()[0])
    (motion,), said = read(tmp_path / 'log.csv')
    # 50 times 0.05 N m/A; the forces have five digits, and are interpolated.
    np.testing.assert_allclose(motion.tau[:, 0], 2.5 * U, atol=1e-4)
    assert '100000 counts per turn; 2.5 N m/A' in said
    configuration = configuration_of([str(tmp_path / 'log.csv')])
    assert configuration['coordinates'][0]['p_unit'] == 'N m s'


def test_counts_per_turn_are_an_option_for_logs(tmp_path):
    path = tmp_path / 'log.csv'
    path.write_text(REFUSED['counts of an unknown turn']())
    for count in (4096.0, 8192.0):
        data = source_of(str(path), counts=count)
        assert is_meant(read_motions(path, data, ['x'], [str(path)], ['rad'])[0],
                        4096.0 / count * Q) and data.counts == count
    np.savez(tmp_path / 'log.npz', t=T)
    with refused(DataError):
        configuration_of([str(tmp_path / 'log.npz')], 4096.0)


@pytest.mark.parametrize(('parser', 'before'), [
    (arguments.train, []), (arguments.evaluate, ['m']), (identify.identify, ['s'])])
def test_logs_may_be_given_one_by_one(parser, before):
    given = parser().parse_args([*before, '--data', 'a', 'b', '--data', 'c'])
    assert [str(one) for one in given.data] == ['a', 'b', 'c']


@pytest.mark.parametrize('encoding', ['utf-16', 'cp1252'])
def test_log_of_another_encoding_is_read_where_it_is_named(tmp_path, encoding):
    path = tmp_path / 'log.csv'
    path.write_bytes(rows(T, DEG, head='t,angle (°)').encode(encoding))
    with refused(DataError):
        read(path)
    data = LogMotions(encoding=encoding, time='t', q=['angle (°)'])
    assert is_meant(read_motions(path, data, ['x'], [str(path)], ['rad'])[0], Q)


@pytest.mark.parametrize('shape', REFUSED)
def test_log_of_no_reading_is_refused_in_a_line(tmp_path, shape):
    text = REFUSED[shape]()
    path = tmp_path / 'log.csv'
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    with refused(DataError):
        read(path)


def test_force_opposite_to_a_coordinate_is_said_and_may_be_that_of_a_controller(tmp_path):
    path = tmp_path / 'log.csv'
    path.write_text(rows(T, Q, 0.7 - 2.0 * Q, head='t,theta [rad],torque [Nm]'))
    (motion,), said = read(path)
    # Both columns have five digits.
    np.testing.assert_allclose(motion.tau[:, 0], 0.7 - 2.0 * motion.q[:, 0], atol=2e-5)
    assert "force 1 is -2 times 'theta [rad]', up to a constant" in said
    path.write_text(rows(T, Q, U, head='t,theta [rad],torque [Nm]'))
    assert 'times' not in read(path)[1]
