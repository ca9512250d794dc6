# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Give each test session its own ROS 2 graph, domain and log folders."""

from collections.abc import Callable
import csv
from dataclasses import dataclass
import fcntl
import os
from pathlib import Path
import shutil
import signal
import socket
import sys
import tempfile
from typing import Any, IO

from hypothesis import HealthCheck, settings
import messages
import pytest

# No deadline: a busy machine is slow, which is not a failure.
settings.register_profile('any machine', deadline=None,
                          suppress_health_check=[HealthCheck.too_slow])
settings.load_profile('any machine')

# Files started first if several processes share them, so that no long one remains for a single
# process at the end: those that take more than 20 s of CPU time without compiled kernels, and
# those of nodes that take as long in wall time.
LONGEST = (
    'learning/test_prior_choice.py', 'learning/test_position_fits.py',
    'learning/test_input_courses.py', 'learning/test_user_module.py', 'learning/test_export.py',
    'learning/test_drive_friction.py', 'sweeps/test_sweep.py', 'learning/test_new_family.py',
    'learning/test_unchanged_arguments.py', 'studies/test_work_precision.py',
    'studies/test_hard_cases.py', 'project/test_planted_faults.py',
    'commands/test_scene_tool.py', 'simulation/accuracy/test_calibration.py',
    'simulation/test_assembly.py', 'project/test_linters.py', 'commands/test_cli.py',
    'learning/test_rigid_body.py', 'learning/test_machine_training.py',
    'learning/test_input_map.py', 'learning/test_family_training.py',
    'models/test_shipped_models.py', 'models/test_mechanical_mean.py', 'models/test_confined.py',
    'learning/test_train.py',
    'learning/test_identify.py', 'project/test_benchmarks.py', 'ros/test_simulator.py',
    'ros/test_health.py', 'ros/test_services.py', 'ros/test_memory.py', 'ros/test_soak.py',
    'ros/test_lifecycle.py', 'ros/test_hostile_messages.py',
    'ros/test_time_control.py', 'ros/test_topics.py',
    'ros/test_given_parameters.py', 'ros/test_recording.py',
    'ros/test_replay_check.py', 'ros/test_launch.py', 'ros/test_security.py',
    'ros/test_web_viewer.py')

# Domains above 101 use ports in Linux's ephemeral range, where any program may listen.
_DOMAINS = range(1, 101)
_claimed: list[IO[str]] = []


def _discovery_port_is_free(domain: int) -> bool:
    # RTPS: the discovery port of a domain is 7400 + 250 * domain. Binding it without SO_REUSEADDR
    # fails if a participant of another program uses it.
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        try:
            probe.bind(('', 7400 + 250 * domain))
        except OSError:
            return False
    return True


def _claim_domain() -> int:
    """Return a domain that no other test session on this host uses, and lock it."""
    folder = Path(tempfile.gettempdir())
    first = os.getpid() % len(_DOMAINS)
    for domain in [*_DOMAINS[first:], *_DOMAINS[:first]]:
        lock = (folder / f'ros-test-domain-{os.getuid()}-{domain}.lock').open('w')
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            lock.close()
            continue
        if _discovery_port_is_free(domain):
            _claimed.append(lock)
            return domain
        lock.close()
    raise RuntimeError(f'all ROS domains from 1 to 100 are taken; see the locks in {folder}')


def pytest_configure(config: pytest.Config) -> None:
    """Set the environment before any test module imports rclpy; subprocesses inherit it."""
    os.environ['ROS_AUTOMATIC_DISCOVERY_RANGE'] = 'LOCALHOST'
    os.environ['ROS_DOMAIN_ID'] = str(_claim_domain())
    config.add_cleanup(lambda: [lock.close() for lock in _claimed])
    # Systems as plain Python are slow, which is acceptable in tests of a few steps.
    config.addinivalue_line('filterwarnings', 'ignore:.* is not compiled')
    os.environ.setdefault('MPLBACKEND', 'Agg')
    # Small matrices gain nothing from threads, and threads of several workers block each other.
    for library in ('OMP', 'OPENBLAS', 'MKL'):
        os.environ.setdefault(f'{library}_NUM_THREADS', '1')
    # A Python process started by a test in this folder imports the build, as this one does, and
    # not the sources here, whose kernels would be compiled again.
    os.environ['PYTHONSAFEPATH'] = '1'
    if (Path(sys.prefix) / 'share' / 'ament_index').is_dir():  # a venv with the ROS 2 wheels
        os.environ.setdefault('AMENT_PREFIX_PATH', sys.prefix)
    if config.getoption('--messages') and messages.RECORD not in os.environ:
        os.environ[messages.RECORD] = tempfile.mkdtemp(prefix='ros-test-messages-')
    logs = tempfile.TemporaryDirectory(prefix='ros-test-log-', ignore_cleanup_errors=True)
    config.add_cleanup(logs.cleanup)
    os.environ['ROS_LOG_DIR'] = logs.name


def pytest_runtest_setup() -> None:
    """Restore the default handler of SIGINT, which earlier code may have changed or ignored."""
    signal.signal(signal.SIGINT, signal.default_int_handler)


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Move the longest files to the front; keep the order within files."""
    places = {Path(__file__).parent / name: place for place, name in enumerate(LONGEST)}
    if missing := [str(path) for path in places if not path.is_file()]:
        raise pytest.UsageError(f'{__file__}: LONGEST has no file {", ".join(missing)}')
    items.sort(key=lambda item: places.get(item.path, len(LONGEST)))


@dataclass(frozen=True)
class Finding:
    """Value measured by a test of a claim, and the asserted bound."""

    claim: str
    subject: str
    value: float
    bound: str


_findings: list[Finding] = []
# Tests that have run.
_finished: set[str] = set()


@pytest.fixture
def measured(record_property: Callable[[str, object], None]
             ) -> Callable[[str, str, float, str], None]:
    """Return a function that records claim, subject, measured value and bound."""
    # A property of the test's report, which is passed between processes as well.
    return lambda claim, subject, value, bound: record_property(
        'finding', [claim, subject, float(value), bound])


def pytest_runtest_logreport(report: pytest.TestReport) -> None:
    """Collect the measurements of a test."""
    _finished.add(report.nodeid)
    if report.when == 'call':
        rows: list[Any] = [row for name, row in report.user_properties if name == 'finding']
        _findings.extend(Finding(*row) for row in rows)


def pytest_addoption(parser: pytest.Parser) -> None:
    """Add the options that update the files with expected results."""
    parser.addoption('--findings', type=Path, metavar='FILE',
                     help='write what the verification tests measured into a CSV')
    parser.addoption('--messages', action='store_true',
                     help='write the tables of error messages again')
    parser.addoption('--policy', action='store_true',
                     help='write the SROS2 policy of the simulator as it is in the graph')


def pytest_sessionfinish(session: pytest.Session) -> None:
    """Write the tables of messages, and the findings as a CSV by claim and subject."""
    # Workers of pytest-xdist know only the measurements of their own tests.
    if hasattr(session.config, 'workerinput'):
        return
    if session.config.getoption('--messages'):
        notes = Path(os.environ.pop(messages.RECORD))
        messages.write_tables(notes, _finished)
        shutil.rmtree(notes)
    path = session.config.getoption('--findings')
    if path is None:
        return
    rows = sorted(_findings, key=lambda row: (row.claim, row.bound, row.subject))
    with path.open('w', newline='', encoding='utf-8') as file:
        csv.writer(file, lineterminator='\n').writerows(
            [['claim', 'bound', 'subject', 'measured'],
             *([row.claim, row.bound, row.subject, f'{row.value:.3g}'] for row in rows)])


def pytest_report_header() -> str:
    """Name the domain, for the investigation of a failed run."""
    return f'ROS_DOMAIN_ID: {os.environ["ROS_DOMAIN_ID"]}'
