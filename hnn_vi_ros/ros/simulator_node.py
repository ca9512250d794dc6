# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""The simulator node: its lifecycle, from parameters to a run, and the process around it."""

from collections.abc import Sequence
import gc
import os
import time

from hnn_vi_ros.errors import HnnViRosError, ParameterError
from hnn_vi_ros.recording import BagTopics
from hnn_vi_ros.ros import arguments as command_lines
from hnn_vi_ros.ros.initial_state import subscribe_initial_states
from hnn_vi_ros.ros.node_parameters import Parameters, refuse_unknown
from hnn_vi_ros.ros.plumbing.graph import Discovery, take_once
from hnn_vi_ros.ros.plumbing.managed_node import steady_timer, SUCCESS
from hnn_vi_ros.ros.plumbing.rclpy_internals import log
from hnn_vi_ros.ros.plumbing.starting import own_arguments, ros_process
from hnn_vi_ros.ros.run.control import Answer, Control, Simulator
from hnn_vi_ros.ros.run.preparation import check_pace, compile_rest, OPENING, prepare, PreparedRun
from hnn_vi_ros.ros.run.run import Run
from hnn_vi_ros.ros.services import offer_services
from hnn_vi_ros.ros.settings import PARAMETERS, Settings
from hnn_vi_ros.ros.topics.topics import ENDPOINTS, Topics
from hnn_vi_ros.ros.worlds import unquoted
from hnn_vi_ros.simulation import Simulation
from lifecycle_msgs.msg import State
from rclpy.lifecycle import LifecycleState, TransitionCallbackReturn

# Wall time between two log lines during a long configuration [s].
_PROGRESS_PERIOD = 5.0
# Wait at the end for files that are being opened [s].
_OPENING_TIMEOUT = 5.0


class SimulatorNode(Simulator):
    """
    Node that simulates a scene at a given pace, and publishes, records and displays it.

    Parameters
    ----------
    arguments : sequence of str, optional
        Command line with the parameters.

    Attributes
    ----------
    topics : Topics or None
        Publishers and subscriptions of the node; None while it is not configured.

    Raises
    ------
    ParameterError
        A parameter is not usable; one line.

    """

    def __init__(self, arguments: Sequence[str] = ()):
        super().__init__('hnn_simulator')
        self.topics: Topics | None = None
        self._incomplete, self._stage = False, ''
        self._prepared: PreparedRun | None = None
        self._declared = Parameters(self, self.check, self.apply)
        self.scene_of_the_start = self.settings.scene
        refuse_unknown(self, PARAMETERS, ENDPOINTS, arguments)
        offer_services(self)

    @property
    def refusal(self) -> str:
        """Return the reason that there is no run to act on."""
        if self.state == State.TRANSITION_STATE_CONFIGURING:
            return f'configuring: {self._stage}; call again once the node is configured'
        return 'the node is not configured: use the transition configure first'

    @property
    def settings(self) -> Settings:
        """Return the values of the parameters."""
        return self._declared.settings

    @property
    def ticking(self) -> bool:
        return self.control is not None and self.control.ticking

    async def on_configure(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Load and compile the scene and open the files; serve in the meantime."""
        self._declared.configured = True
        settings, begin = self.settings, time.monotonic()
        progress = steady_timer(self, _PROGRESS_PERIOD, lambda: self.get_logger().info(
            f'configuring: {self._stage}, {time.monotonic() - begin:.0f} s so far'))
        try:
            # Created at once, so that other nodes discover them while the kernel is compiled.
            self.topics = Topics(self, settings)
            topics, discovery = self.topics.descriptions, Discovery(
                self.topics.count_subscribers, settings.discovery_time)
            prepared = await self.in_thread(lambda: self._prepare(settings, topics, discovery))
            self.run = Run(self, self.topics, prepared, settings, self.stop)
            self.check(settings)
            subscribe_initial_states(self, self.topics, self.run, self._reset_to_state)
        finally:
            self.destroy_timer(progress)
        self.control = Control(self, self.run, discovery, settings)
        # Parameters may have been changed during the configuration.
        self.apply(self.settings)
        if not prepared.simulation.rescue_ready:
            self.spinner.create_task(self._compile_rest, prepared.simulation)
        return SUCCESS

    async def _compile_rest(self, simulation: Simulation) -> None:
        """Compile, during the run, functions that it may need later."""
        await self.in_thread(lambda: compile_rest(simulation))
        # Exclude the compiled objects from garbage collection, as in Control.
        gc.freeze()

    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Start or resume the run."""
        self._driven.activate()
        return SUCCESS

    def on_deactivate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Pause the run and keep its state."""
        self._driven.deactivate()
        return SUCCESS

    def on_cleanup(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Close the files and discard the run; the exit status reflects incomplete files."""
        self._close_run()
        self._forget()
        return SUCCESS

    def roll_back(self) -> None:
        self._close_prepared()
        self._forget()

    def stop(self, status: int, reason: str) -> None:
        """Take no more steps, and let the process end with this status."""
        if self.exit_status is None:
            self.exit_status = status
            level = 'ERROR' if status else 'INFO'
            if self.run is None:
                log(self, reason, level)
            else:
                self.run.tell(reason, level)
            if self.control is not None:
                self.control.stop()

    def finish(self) -> int:
        """Close and report the files, and return the exit status; use only the log of ROS."""
        if self.run is None:
            self._close_prepared()
        self._close_run()
        if self._incomplete:
            self.exit_status = self.exit_status or 1
        return self.exit_status or 0

    def check(self, settings: Settings) -> None:
        """Raise ParameterError if changed parameters do not fit the current run, if any."""
        if self.run is not None:
            check_pace(settings.real_time_factor, self.run.sampler.tick)
            if settings.payload:
                self.run.payload_in(settings)

    def apply(self, settings: Settings) -> None:
        """Apply changed parameters to the current run, if any."""
        if self.control is not None:
            self.control.run.apply(settings)
            self.control.set_period()

    @property
    def _driven(self) -> Control:
        """Return the control of the run; only for a configured node."""
        assert self.control is not None
        return self.control

    def _prepare(self, settings: Settings, topics: BagTopics, discovery: Discovery) -> PreparedRun:
        """Prepare a run and store it, as the node may be stopped before it takes the result."""
        started = self._declared.started
        try:
            self._prepared = prepare(
                settings, topics, discovery, self.get_logger(), self._set_stage,
                settings.trust_code or settings.scene == started.scene)
        except HnnViRosError as problem:
            same = (settings.scene, settings.resume) == (started.scene, started.resume)
            if same or self._stage == OPENING:
                raise
            bag = settings.resume and os.path.abspath(settings.resume)
            raise unquoted(problem, bag or settings.scene) from None
        return self._prepared

    def _close_prepared(self) -> None:
        """Close the files of a run that has not begun, including those being opened."""
        if self._stage == OPENING:
            self.wait(_OPENING_TIMEOUT)
        if self._prepared is not None:
            self._prepared.recording.close()

    def _set_stage(self, stage: str) -> None:
        if self.exit_status is not None:
            # Files that are opened from now on would never be closed.
            raise ParameterError('the node was stopped')
        self._stage = stage

    def _reset_to_state(self) -> Answer | None:
        """Reset at once if reset_on_initial_state is set, else return None."""
        settings = self.settings
        return self._driven.reset(settings.reset_time) if settings.reset_on_initial_state else None

    def _close_run(self) -> None:
        if self.run is not None and not self.run.close():
            self._incomplete = True

    def _forget(self) -> None:
        """Return to the unconfigured state."""
        if self.control is not None:
            self.control.close()
        if self.topics is not None:
            self.topics.close()
        self.run = self.control = self.topics = self._prepared = None
        self._declared.configured, self._stage = False, ''


def main(argv: list[str]) -> int:
    """Run the node until its duration is over, a guard stops it, or a signal arrives."""
    command_lines.simulator().parse_args(own_arguments(argv))
    # The signal handlers of rclpy would shut down the context before the files are closed.
    with ros_process(argv) as received:
        node = SimulatorNode(argv)
        try:
            executor = node.serve(received, node.settings.autostart)
            if node.control is not None:
                # Answer pending requests for steps.
                take_once(executor)
            if node.topics is not None:
                node.topics.wait_for_delivery(received)
        finally:
            status = node.end(node.finish())
    return status
