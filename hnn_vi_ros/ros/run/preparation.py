# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Preparation of a run, which takes long and therefore runs in its own thread."""

from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, nullcontext
from dataclasses import replace
import time
from typing import Any, NamedTuple, TYPE_CHECKING
import warnings

from hnn_vi_ros.effects import LoopManifold, OBSERVATION
from hnn_vi_ros.errors import listed, ParameterError
from hnn_vi_ros.kernels import announced, kept_only, NotKept
from hnn_vi_ros.recording import BagTopics
from hnn_vi_ros.ros.plumbing.graph import Discovery, DISCOVERY_PERIOD, freeze_memory
from hnn_vi_ros.ros.plumbing.rclpy_internals import Logger
from hnn_vi_ros.ros.recording import RunRecording
from hnn_vi_ros.ros.run.lockstep import Lockstep
from hnn_vi_ros.ros.settings import Settings
from hnn_vi_ros.ros.topics.inputs import JOINT_COMMANDS
from hnn_vi_ros.run import (
    compile_in_background, joint_sensor, JointSensor, LAST_STATE_FILE, Members, preview_bounds,
    REMAPPED, restore_state, Sampler, scene_report, stamp_of, Twin)
from hnn_vi_ros.scene import AutoChoice, load_scene, Parts, Scene
from hnn_vi_ros.simulation import (
    BandGuard, BoxGuard, build, Choice, choose, Chosen, EnergyGuard, PoleGuard,
    RunFacts, Simulation, StateGuard, Tolerance, tolerance_of, Watch)
import numpy as np

if TYPE_CHECKING:
    from hnn_vi_ros.run import ResumePoint


class LogLine(NamedTuple):
    """A line for the log and for display with the samples; level is INFO, WARN or ERROR."""

    text: str
    level: str


def choose_method(scene: Scene, largest_step: float, real_time_factor: float, logger: Logger
                  ) -> tuple[Scene, Chosen | None, list[LogLine]]:
    """
    Choose the method and step size; return the resolved scene, the choice, and log lines on it.

    Parameters
    ----------
    scene : Scene
        Scene with the integrator auto or any other.
    largest_step : float
        Time that the step size must divide if the scene does not specify a step size [s].
    real_time_factor : float
        Requested pace; 0 for as fast as possible.
    logger : Logger
        Logger of a line before the calibration, which takes a while.

    Raises
    ------
    HnnViRosError
        No method meets the tolerance, or the scene cannot be built.

    """
    if isinstance(scene.integrator, AutoChoice):
        tolerance = tolerance_of(scene.integrator)
        logger.info(
            f'scene {scene.source}: calibrating for {tolerance.kind} {tolerance.error:g} up to '
            f'{tolerance.horizon:g} s; takes some seconds, once, or longer if integrators must be '
            'compiled')
    resolved, chosen = choose(scene, largest_step)
    lines = choice_lines(*chosen, real_time_factor) if chosen else []
    if chosen and scene.step_size is None:
        lines.append(LogLine(
            f'auto chose for steps that divide the sampling interval, {largest_step:g} s; hnn run '
            'has none and may choose another method: set step_size in the scene for one choice',
            'INFO'))
    return resolved, chosen, lines


def choice_lines(tolerance: Tolerance, choice: Choice, real_time_factor: float) -> list[LogLine]:
    """Return log lines on a choice at a pace."""
    lines = [LogLine(choice.explain(tolerance), 'INFO')]
    cost = choice.seconds_per_simulated_second
    if cost * real_time_factor > 1.0:
        lines.append(LogLine(
            f'no integrator achieves {tolerance.kind} {tolerance.error:g} up to '
            f'{tolerance.horizon:g} s at real_time_factor {real_time_factor:g} on this machine: '
            f'the cheapest takes {cost:.3g} s per simulated second; use a real_time_factor of at '
            f'most about {1.0 / cost:.2g}, or allow a larger error', 'WARN'))
    return lines


# The last stage, which creates the files.
OPENING = 'opening the files'
# Simulated time that fits into the picture, at a real_time_factor of 1 [s].
_PREVIEW_TIME = 30.0
# Largest accepted wall time between two samples [s].
_MAX_SAMPLE_INTERVAL = 1e6


class PreparedRun(NamedTuple):
    """
    Result of the preparation.

    Parameters
    ----------
    scene : Scene
        The scene to simulate, resolved.
    chosen : Chosen or None
        Choice for the integrator auto, if the scene has it.
    simulation : Simulation
        Compiled simulation of the scene in its initial state; see ``rescue_ready``.
    box : tuple of np.ndarray, shape (d, 2) each
        Lowest and highest q and p that fit into pictures.
    report : dict
        Contents of ``~/scene``.
    recording : Recording
        The open files.
    log_lines : list of LogLine
        Lines to log.
    origin : int
        Stamp of step 0 [ns].
    members : Members or None
        Members of an ensemble, if the scene specifies an uncertainty.
    twin : Twin or None
        Twin that compares the run with a machine, if the scene has an observer.
    sensor : JointSensor or None
        Sensor whose readings joint_states holds, if the scene has one.
    lockstep : Lockstep or None
        Wait for the commands of a controller, if the parameter asks for it.

    """

    scene: Scene
    chosen: Chosen | None
    simulation: Simulation
    box: tuple[np.ndarray, np.ndarray]
    report: dict[str, Any]
    recording: RunRecording
    log_lines: list[LogLine]
    origin: int
    members: Members | None = None
    twin: Twin | None = None
    sensor: JointSensor | None = None
    lockstep: Lockstep | None = None


def prepare(settings: Settings, topics: BagTopics, discovery: Discovery, logger: Logger,
            begin: Callable[[str], None], trust_code: bool = False) -> PreparedRun:
    """
    Load the scene, compile it, look ahead at its motion, and open the files.

    An autostarted run has no files until its first step is due. If the process is killed, its
    bag therefore covers the whole time since the creation of the bag.

    Parameters
    ----------
    settings : Settings
        The node's parameters.
    topics : BagTopics
        Topics in the bag.
    discovery : Discovery
        Discovery of subscribers, which the first step waits for.
    logger : Logger
        Logger of the progress.
    begin : callable
        Called with a short name at the start of each stage.
    trust_code : bool, optional
        True if the parameter `scene` may name Python code: the user has set it.

    Raises
    ------
    HnnViRosError
        A parameter, the scene, its model or a file is not usable; one line.

    """
    announced_before = False

    def tell(line: str) -> None:
        # A scene has many parts; the progress of the configuration says how long they take.
        nonlocal announced_before
        if not announced_before:
            logger.info('compiling parts of the scene, once; later starts load them from disk')
        announced_before = True

    if settings.lockstep_period and not settings.lockstep:
        raise ParameterError('parameter lockstep_period: has no effect without lockstep; set '
                             'lockstep:=true, or remove lockstep_period')
    begin('loading the scene')
    factor = settings.real_time_factor
    scene, found = _load(settings, trust_code)
    begin('selecting the integrator')
    scene, chosen, log_lines = choose_method(scene, 1.0 / settings.publish_rate, factor, logger)
    begin('compiling the kernel')
    simulation, members, twin, ready = _build(scene, settings.publish_accuracy, logger, tell)
    if found is not None:
        log_lines += _continue(simulation, scene, found, settings.resume)
    if settings.publish_loop_forces and not isinstance(
            simulation.system.constraints, LoopManifold):
        raise ParameterError('parameter publish_loop_forces: the scene has no loops; remove it')
    origin = 0 if found is None else found.origin
    sampler = Sampler(simulation, settings.publish_rate, origin)
    sampler.count(settings.duration)
    sensor = joint_sensor(scene, simulation, sampler.every)
    lockstep = None
    if settings.lockstep:
        if not JOINT_COMMANDS.holds & simulation.motors.takes:
            raise ParameterError(
                f'parameter lockstep: the scene takes no commands on {JOINT_COMMANDS.topic}; add '
                'the effect servo, or external_force with coordinates')
        lockstep = Lockstep(settings, sampler.every, simulation.step_size)
    check_pace(factor, sampler.tick)
    begin('previewing the run')
    seconds = _PREVIEW_TIME * (factor or 1.0)
    with announced(tell):
        box = simulation.hamiltonian.box or preview_bounds(
            simulation, min(seconds, settings.duration or seconds))
    report = scene_report(scene, simulation, origin, chosen)
    if topics.remapped:
        report[REMAPPED] = dict(topics.remapped)
    while settings.autostart and not discovery.over:
        begin('waiting for subscribers')
        time.sleep(DISCOVERY_PERIOD)
    # Before the files are created, because it takes a while and they must hold all that follows.
    freeze_memory()
    begin(OPENING)
    recording = RunRecording(logger, scene, simulation, settings, topics, box, report, sampler)
    simulation.rescue_ready = ready
    return PreparedRun(scene, chosen, simulation, box, report, recording, log_lines, origin,
                       members, twin, sensor, lockstep)


def _load(settings: Settings, trust_code: bool) -> tuple[Scene, 'ResumePoint | None']:
    """Return the scene, and the point from which a log is resumed."""
    step_size, integrator = settings.step_size or None, settings.integrator or None
    own = load_scene(settings.scene, trust_code) if (
        not settings.resume or settings.scene != Settings.scene) else None
    if not settings.resume:
        assert own is not None, 'a run that is not resumed has a scene'
        scene = own.with_overrides(step_size, integrator)
        return scene.changed({'energy_by_cause': True}) if settings.energy_by_cause else scene, \
            None
    if step_size or integrator:
        name = 'step_size' if step_size else 'integrator'
        raise ParameterError(f'parameter {name}: cannot be changed in a resumed run; remove it, '
                             'or remove resume')
    # Imported lazily: only resumed runs read a bag.
    from hnn_vi_ros.run import resume
    found = resume(settings.resume, settings.trust_code)
    if own is not None:
        state = found.scene.initial_state
        return _fitting(own, found.scene).changed({'initial_state': {
            'q': [*state.q], 'p': [*state.p]}}), replace(found, state=None)
    if settings.energy_by_cause and not found.scene.energy_by_cause:
        raise ParameterError('parameter energy_by_cause: the resumed run did not account for it '
                             'from its start; remove it, or remove resume')
    return found.scene, found


def _fitting(scene: Scene, recorded: Scene) -> Scene:
    """Return a scene that continues another, or raise ParameterError."""
    own, other = ([one.name for one in each.create_hamiltonian().coordinates]
                  for each in (scene, recorded))
    if own != other or scene.step_size != recorded.step_size:
        raise ParameterError(
            f'parameter scene: {scene.name} has the coordinates {listed(own)} and step_size '
            f'{scene.step_size}, but the bag to resume has {listed(other)} and '
            f'{recorded.step_size}; write its scene with hnn scene --new FILE --like BAG, and '
            'change the effects alone')
    return scene


def _continue(simulation: Simulation, scene: Scene, found: 'ResumePoint', bag: str
              ) -> Iterator[LogLine]:
    """Continue the run of a bag; yield lines for the log."""
    start, how = scene.initial_state, 'q and p alone'
    simulation.restart(start.q, start.p, step=found.step)
    if found.state is not None:
        restore_state(simulation, found.state, bag, name=LAST_STATE_FILE)
        how = 'its complete state'
        if simulation.steps != found.step or not np.array_equal(simulation.q, start.q):
            # The last steps of the run have no sample.
            simulation.restart(start.q, start.p, step=found.step)
            how = 'q and p alone'
    seconds = stamp_of(found.step, simulation.step_size, found.origin) / 1e9
    yield LogLine(f'resumed {bag} at t = {seconds:.9g} s from {how}', 'INFO')
    if found.damage:
        yield LogLine(found.damage, 'WARN')


def check_pace(real_time_factor: float, tick: float) -> None:
    """Raise ParameterError for a pace at which samples would be too far apart."""
    if real_time_factor * _MAX_SAMPLE_INTERVAL < tick and real_time_factor > 0.0:
        raise ParameterError(
            f'parameter real_time_factor = {real_time_factor:g}: more than '
            f'{_MAX_SAMPLE_INTERVAL:.0e} s would pass between two samples; increase it')


class _RunParts(NamedTuple):
    simulation: Simulation
    members: Members | None
    twin: Twin | None
    rescue_ready: bool


def _build(scene: Scene, publish_accuracy: bool, logger: Logger, tell: Callable[[str], None]
           ) -> _RunParts:
    """Return the compiled simulation and its companions."""
    with announced(tell):
        parts = scene.parts()
    # Not announced, since it looks the loop up and does not compile it.
    with compile_in_background(parts), announced(tell):
        simulation = _compile(parts, logger)
    with announced(tell):
        with scene.placed('uncertainty'):
            members = None if scene.uncertainty is None else Members(parts)
        twin = Twin(scene, simulation) if OBSERVATION in simulation.motors.takes else None
        # A run with events, accuracy or companions never waits for a compilation.
        alone = not (scene.events or publish_accuracy or members or twin)
        ready = compile_rest(simulation, kept_only if alone else nullcontext)
    return _RunParts(simulation, members, twin, ready)


def _compile(parts: Parts, logger: Logger) -> Simulation:
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter('always')
        start = time.perf_counter()
        simulation = build(parts)
        # Compile or load the code of the guards here, not while the node must answer; and before
        # the loop, which may be being compiled by another process and with which paths are tried.
        watch = Watch(RunFacts(simulation), (
            StateGuard, BandGuard, BoxGuard, EnergyGuard, PoleGuard))
        watch.observe()
        _ = watch.alarms
        simulation.compile()
        # Compile the functions that state messages and the picture call.
        simulation.hamiltonian.energy(simulation.q, simulation.p)
        simulation.hamiltonian.gradient(simulation.q, simulation.p)
    for warning in caught:
        logger.warning(str(warning.message))
    seconds = time.perf_counter() - start
    logger.info(f'scene {parts.scene.source}: its step is ready after {seconds:.2f} s')
    return simulation


def compile_rest(simulation: Simulation,
                 where: Callable[[], AbstractContextManager[None]] = nullcontext) -> bool:
    """Compile H'' and the rescue of failed steps for later; return False if `where` forbids it."""
    try:
        with where():
            simulation.hamiltonian.compile()
            simulation.compile_rescue()
    except NotKept:
        return False
    return True
