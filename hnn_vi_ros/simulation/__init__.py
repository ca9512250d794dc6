# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""
Simulations: compiled loops over the steps of a scene, and computations based on them.

Four steps, which simulate, simulate_many, sweeps and the node share: ``resolve`` a scene into its
parts, ``build`` a Simulation, ``record`` samples, ``judge`` them. ``rescue`` retries failed steps;
``events`` locates events.
Sub-packages: ``trajectory`` (whole runs), ``accuracy`` (errors, costs, `integrator: auto`),
``guards`` (alarms), ``batches`` (many runs in torch), ``gradients`` (sensitivities, adjoints).
"""

from typing import TYPE_CHECKING

from hnn_vi_ros.exports import lazy_exports

if TYPE_CHECKING:
    from hnn_vi_ros.simulation.accuracy.automatic_choice import (
        Choice, choose, Chosen, problem_of, tolerance_of)
    from hnn_vi_ros.simulation.accuracy.cost import CostStudy, measure_costs, MethodCost
    from hnn_vi_ros.simulation.accuracy.diagnostics import local_error, secular_change
    from hnn_vi_ros.simulation.accuracy.lyapunov import lyapunov_time
    from hnn_vi_ros.simulation.accuracy.neighbouring_motions import time_between_motions
    from hnn_vi_ros.simulation.accuracy.trials import (
        InitialValueProblem, Method, time_scale, Tolerance)
    from hnn_vi_ros.simulation.assembly import advance, take_substeps
    from hnn_vi_ros.simulation.batches.batch_simulation import (
        BatchSimulation, description, open_device)
    from hnn_vi_ros.simulation.checks import check_count, check_numbers, check_seconds
    from hnn_vi_ros.simulation.construction import build, build_at, compile_loop, resolve
    from hnn_vi_ros.simulation.dense_step import whole_steps
    from hnn_vi_ros.simulation.events import watched, WatchedSimulation
    from hnn_vi_ros.simulation.following import CommandLaw
    from hnn_vi_ros.simulation.gradients.acting_effects import (
        ActingEffects, check_effects, flow_rates)
    from hnn_vi_ros.simulation.gradients.dependences import (
        Dependence, derivative, difference, OnNumber, StateSequence, sum_of)
    from hnn_vi_ros.simulation.gradients.derivatives import Change, DifferentiableRun, RunRecord
    from hnn_vi_ros.simulation.gradients.of_hamiltonian import base_of, OnHamiltonian, OnLagrangian
    from hnn_vi_ros.simulation.gradients.scene_run import check_in_files, Numbers, SceneRun
    from hnn_vi_ros.simulation.guards.bands import BandGuard, EnergyGuard, is_wrong
    from hnn_vi_ros.simulation.guards.base import (
        Alarm, BlockGuard, Guard, judge_block, StateGuard)
    from hnn_vi_ros.simulation.guards.bounds import BoxGuard, SpreadGuard
    from hnn_vi_ros.simulation.guards.facts import RunFacts
    from hnn_vi_ros.simulation.guards.poles import PoleGuard
    from hnn_vi_ros.simulation.guards.samples import Observed, SampleBuffer
    from hnn_vi_ros.simulation.guards.scale import SampledScale
    from hnn_vi_ros.simulation.guards.watch import (
        judge, judge_many, look, make_guards, Watch)
    from hnn_vi_ros.simulation.processors import (
        ignore_sigint_in_children, in_threads, usable_processors, worker_processes)
    from hnn_vi_ros.simulation.rescue import Fallbacks
    from hnn_vi_ros.simulation.run_samples import check_memory, record, RunSamples, Schedule
    from hnn_vi_ros.simulation.path_error import PathError
    from hnn_vi_ros.simulation.second_run import PathReport
    from hnn_vi_ros.simulation.simulation import RescuePending, Simulation
    from hnn_vi_ros.simulation.system import System
    from hnn_vi_ros.simulation.trajectory.devices import batch_on, one_thread_each, record_on
    from hnn_vi_ros.simulation.trajectory.many import (
        BLOCK, drawn, MAX_MEASURED_STEPS, measure_alone, record_block, simulate_many)
    from hnn_vi_ros.simulation.trajectory.simulate import changed_parts, record_one, simulate
    from hnn_vi_ros.simulation.trajectory.trajectory import EnergyByCause, Trajectory

__getattr__, __dir__ = lazy_exports(__name__)
