# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""The executables: modules are imported lazily, and a missing package is a one-line error."""

from collections.abc import Callable, Sequence
from contextlib import chdir
from functools import partial
import gc
from importlib import import_module
from importlib.abc import MetaPathFinder
from importlib.machinery import ModuleSpec, PathFinder
import math
import os
from pathlib import Path
import re
import resource
import signal
import sys
import time
from types import FrameType, ModuleType
from typing import Any, NoReturn
import warnings

from hnn_vi_ros.commands import (
    check_names, COMMANDS, EXECUTABLES, module_of, parser_of, refuse)
from hnn_vi_ros.errors import HnnViRosError, ParameterError, pip_command
from hnn_vi_ros.files import (
    ENDING, harden_streams, lost_output, private_folder, usual_folder, write_problem)
from hnn_vi_ros.ros import prepare_ros_environment

# Import names of ROS 2, and the wheels that contain them.
_ROS = ('ament_index_python', 'rclpy', 'builtin_interfaces')
_ROS_WHEELS = ('ros-jazzy-rclpy[fastrtps]', 'ros-jazzy-common-interfaces')
# Packages of the extra `train` besides rerun; simulations do not need them.
_TRAINING = ('plotly', 'torch')
# Period in which several SIGINT count as one [s].
_INTERRUPT_PERIOD = 1.0
# Number of new objects after which garbage is collected.
_COLLECTED_AFTER = 50_000
# Message for work that cannot be resumed.
_STOPPED = 'stopped: nothing more is written; the same command starts from the beginning'
# Least limits of memory below which libraries abort [bytes], by option of ulimit.
_LEAST = {'-v': (resource.RLIMIT_AS, 640 << 20), '-s': (resource.RLIMIT_STACK, 1 << 20)}
# Patterns of variables that numba, or its compiler, cannot be imported without.
_NUMBA = {'NUMBA_DISABLE_JIT': '0?', 'NUMBA_NUM_THREADS': '[1-9][0-9]{0,4}',
          'NUMBA_CPU_FEATURES': r'([+-][\w.-]+(,(?!$)|$))*'}
# Exit status of a process terminated by SIGINT, as in shells.
_INTERRUPTED = 128 + signal.SIGINT


def main() -> NoReturn:
    """Run ``hnn``: one command for all executables, and for commands without ROS."""
    if '_ARGCOMPLETE' in os.environ:
        # A shell requests completions and ignores other output.
        import_module('hnn_vi_ros.commands.completion').complete()
    word, *argv = sys.argv[1:] or ['--help']
    if word == 'help':
        word, argv = argv[0] if argv else '--help', ['--help']
    name = word.replace('-', '_')
    if name in COMMANDS:
        _run(name, argv)
    harden_streams()
    status: str | int | None
    try:
        status = refuse(word)
    except SystemExit as end:
        # From argparse, which has printed the help or the version.
        status = end.code
    sys.exit(_with_output('hnn', status))


def __getattr__(name: str) -> Callable[[], NoReturn]:
    """Return the function that runs an executable, for the entry points of setup.py."""
    if name not in EXECUTABLES:
        raise AttributeError(f'module {__name__!r} has no attribute {name!r}')
    return partial(_run, name)


def _choose_cache() -> None:
    """Set cache folders of libraries to a temporary one if the default is read-only."""
    if 'ROS_LOG_DIR' not in os.environ and usual_folder('ROS_HOME', '.ros') is None:
        os.environ['ROS_LOG_DIR'] = str(private_folder() / 'ros_log')
    if usual_folder() is not None:
        return
    # Otherwise matplotlib would create a new one each time, with a warning.
    if 'MPLCONFIGDIR' not in os.environ:
        os.environ['MPLCONFIGDIR'] = str(private_folder() / 'matplotlib')
    if 'NUMBA_CACHE_DIR' not in os.environ and not os.access(Path(__file__).parent, os.W_OK):
        os.environ['NUMBA_CACHE_DIR'] = str(private_folder())


def _check_shell() -> None:
    """Raise ParameterError for limits and variables with which libraries cannot be imported."""
    for option, (limit, least) in _LEAST.items():
        if 0 <= (allowed := resource.getrlimit(limit)[0]) < least:
            raise ParameterError(f'ulimit {option} allows {allowed >> 10} KiB of memory; at least '
                                 f'{least >> 10} are needed')
    for name, pattern in _NUMBA.items():
        if name in os.environ and not re.fullmatch(pattern, os.environ[name]):
            raise ParameterError(f'{name}={os.environ[name]!r}: numba cannot work with it; unset '
                                 'it')


class _OutsideWorkingFolder(MetaPathFinder):
    """
    Import of libraries that files of the working folder, perhaps of others, would configure.

    Matplotlib reads ``matplotlibrc`` there, before the file that MATPLOTLIBRC names, and numba
    ``.numba_config.yaml``.
    """

    def find_spec(self, name: str, path: Any, target: Any = None) -> ModuleSpec | None:
        spec = PathFinder.find_spec(name, path) if name in ('matplotlib', 'numba') else None
        if spec is not None and spec.loader is not None:
            execute = spec.loader.exec_module

            def execute_elsewhere(module: ModuleType) -> None:
                with chdir(os.sep):
                    execute(module)
            spec.loader.exec_module = execute_elsewhere  # type: ignore[method-assign]
        return spec


def _merge_interrupts() -> None:
    """Make SIGINT raise KeyboardInterrupt, but not again while that is handled."""
    last = -math.inf

    def on_signal(number: int, frame: FrameType | None) -> None:
        nonlocal last
        if time.monotonic() - last > _INTERRUPT_PERIOD:
            last = time.monotonic()
            raise KeyboardInterrupt

    signal.signal(signal.SIGINT, on_signal)


def _is_node(module: str, argv: Sequence[str]) -> bool:
    """Return whether a command is a node, which signals end with status 0."""
    return module.startswith('hnn_vi_ros.ros.') and not {'--verify', '--rerun'} & {
        word.partition('=')[0] for word in argv}


def _end_at_signals(node: bool) -> None:
    """Make signals end the process: C libraries turn SIGINT into other errors of their import."""
    for number in ENDING if node else (signal.SIGINT,):
        if number != signal.SIGHUP or signal.getsignal(number) != signal.SIG_IGN:
            signal.signal(number, lambda *_: os._exit(0 if node else _INTERRUPTED))


def _answer_at_once(name: str, argv: Sequence[str]) -> None:
    """Answer help, mistakes and files that do not exist, without the module's libraries."""
    asked = [word for word in argv if word in ('-h', '--help', '--version')]
    if asked:
        parser_of(name).parse_args(asked[:1])
    if not module_of(name).startswith('hnn_vi_ros.ros.'):
        check_names(parser_of(name), argv)


def _run(name: str, argv: Sequence[str] | None = None) -> NoReturn:
    """Call the ``main`` of an executable, and exit; errors are reported in one line."""
    argv = list(sys.argv[1:] if argv is None else argv)
    shown = f'hnn {name}'
    _end_at_signals(_is_node(module_of(name), argv))
    harden_streams()
    # Imports create many objects and no garbage: collect seldom.
    gc.set_threshold(_COLLECTED_AFTER, *gc.get_threshold()[1:])
    # Otherwise the viewer's library would write to standard error.
    os.environ.setdefault('RUST_LOG', 'off')
    # Threads of numpy's library wait for each other much longer than its small matrices take.
    os.environ.setdefault('OPENBLAS_NUM_THREADS', '1')
    try:
        _choose_cache()
    except OSError as problem:
        sys.exit(f'{shown}: neither the home folder nor a temporary folder is writable '
                 f'({problem.strerror}); set TMPDIR to a writable folder')
    try:
        # Libraries query it at import.
        os.getcwd()
    except FileNotFoundError:
        sys.exit(f'{shown}: the working directory was removed; change to one that exists')
    os.environ |= {name: os.path.abspath(os.environ[name]) for name in (
        'MATPLOTLIBRC', 'MPLCONFIGDIR', 'NUMBA_CACHE_DIR') if os.environ.get(name)}
    sys.meta_path.insert(0, _OutsideWorkingFolder())
    try:
        _check_shell()
        _answer_at_once(name, argv)
        status = run_module(module_of(name), argv, shown)
    except SystemExit as end:
        # From argparse, which has printed the help or an error.
        status = end.code
    except HnnViRosError as problem:
        status = _lines(shown, problem)
    for number in ENDING:
        # Ignore further signals until the interpreter has ended.
        signal.signal(number, signal.SIG_IGN)
    status = _with_output(shown, status)
    if status == _INTERRUPTED:
        # The interpreter's normal exit takes half a second, and waits for compiling threads.
        os._exit(_INTERRUPTED)
    if isinstance(status, str):
        for line in status.splitlines():
            write_problem(line)
        status = 1
    # The interpreter's last collections would take longer than all others.
    gc.freeze()
    sys.exit(status)


def _lines(shown: str, problem: HnnViRosError) -> str:
    return '\n'.join(f'{shown}: {line}' for line in problem.lines)


def run_module(module: str, argv: list[str], shown: str) -> int | str | None:
    """
    Import a module and run its ``main``.

    Parameters
    ----------
    module : str
        Name of the module.
    argv : list of str
        Arguments of ``main``.
    shown : str
        Prefix of the error line.

    Returns
    -------
    int, str or None
        Exit status; or lines for problems that the user can correct.

    """
    try:
        if module.startswith('hnn_vi_ros.ros.'):
            # Before any ROS library is loaded, because some terminate the process.
            prepare_ros_environment()
        _end_at_signals(_is_node(module, argv))
        _warn_in_lines(shown)
        loaded = import_module(module)
        if not _is_node(module, argv):
            # Nodes take signals themselves, see ros_process.
            _merge_interrupts()
        return loaded.main(argv)
    except HnnViRosError as problem:
        return _lines(shown, problem)
    except ModuleNotFoundError as problem:
        if problem.name is None or problem.name.partition('.')[0] == 'hnn_vi_ros':
            raise
        return f'{shown}: {_missing(problem.name.partition(".")[0])}'
    except MemoryError:
        return f'{shown}: the memory is not enough; free some, or give a smaller input'
    except OSError as problem:
        if problem.filename is None or problem.strerror is None:
            raise
        return f'{shown}: {problem.filename}: {problem.strerror}; name another place'
    except KeyboardInterrupt as stop:
        # A command that can be resumed explains how in its message.
        print(f'{shown}: {str(stop) or _STOPPED}', file=sys.stderr)
        return _INTERRUPTED


def _warn_in_lines(shown: str) -> None:
    """Print each warning as one line on standard error, once per text."""
    shown_texts: set[str] = set()

    def show(message: Warning | str, *_where: Any, **_more: Any) -> None:
        text = ' '.join(str(message).split())
        if text not in shown_texts:
            shown_texts.add(text)
            write_problem(f'{shown}: warning: {text}')

    warnings.showwarning = show


def _missing(package: str) -> str:
    """Return a one-line message for a missing package, with the command that installs it."""
    text = f'the Python package {package} is missing; install '
    packages = [package]
    if package in _ROS or package.endswith(('_msgs', '_srvs')):
        text = f'the Python package {package} of ROS 2 is missing; source ROS 2 Jazzy, or install '
        packages = list(_ROS_WHEELS)
    if package in _TRAINING:
        packages = [*_TRAINING, 'rerun']
        text += 'the packages for training (1 GB, or 5 GB with CUDA) '
        # It marks an environment created with `make`, and is written by requirements/make_venv.
        made = Path(sys.prefix) / '.installed'
        if made.is_file():
            checkout = made.read_text(encoding='utf-8').splitlines()[0].partition(' ')[2]
            return f'{text}with: make -C {checkout} build TORCH=cpu (or any, or cuda)'
    else:
        text += 'it ' if len(packages) == 1 else 'its wheels '
    text += f'with: {pip_command(*packages)}'
    if sys.prefix == sys.base_prefix:
        text += ' (preferably in a virtual environment that is active while colcon builds)'
    return text


def _with_output(name: str, status: int | str | None) -> int | str | None:
    """
    Return the exit status if some output may have been lost.

    For a running node, only files and messages matter, and the status is kept. For other commands,
    and for help, the output matters. As in other tools, a reader that closes the pipe early (``|
    head``) causes no message.
    """
    problem, matters = lost_output()
    if problem is None or isinstance(status, str):
        return status
    if isinstance(problem, BrokenPipeError) and matters:
        return status or 128 + signal.SIGPIPE
    print(f'{name}: standard output: {problem.strerror}: the output is lost', file=sys.stderr)
    # Different from all statuses with which executables report findings.
    return status or os.EX_IOERR if matters else status
