# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""
One run without ROS: sampling, pace, monitoring, files of a run, companions.

The command ``hnn run`` and the simulator node both use it. ``replay_check`` repeats a recorded
run. ``companions`` holds the ensemble members and twins that accompany a run. Topics and services
are in ``ros``.
"""

from typing import TYPE_CHECKING

from hnn_vi_ros.exports import lazy_exports

if TYPE_CHECKING:
    from hnn_vi_ros.run.command_messages import (
        COMMAND_TOPICS, CommandTopic, MOMENTS, nanoseconds, read_observation, REMAPPED)
    from hnn_vi_ros.run.companions.members import (
        AccompaniedSimulation, deviation, ensemble_card, member_scenes, Members, simulate_spread,
        with_companions)
    from hnn_vi_ros.run.companions.sensors import (
        joint_sensor, JointReading, joints_of, JointSensor)
    from hnn_vi_ros.run.companions.twin import Report, Twin, VALID
    from hnn_vi_ros.run.compilation import compile_in_background
    from hnn_vi_ros.run.compiled_scenes import compile_scenes
    from hnn_vi_ros.run.monitor import Monitor
    from hnn_vi_ros.run.preview import preview_bounds
    from hnn_vi_ros.run.recorded_run import (
        CAUSES, own_topics, RecordedRun, resume, ResumePoint, simulators)
    from hnn_vi_ros.run.replay_check import check_replay, check_replays, stamp_gaps
    from hnn_vi_ros.run.report import EffectCosts, measure_effects, scene_report
    from hnn_vi_ros.run.run_folder import bag_lines, picture_lines, report_files, RunFiles
    from hnn_vi_ros.run.sampling import nanoseconds_of, Sampler, stamp_of, steps_between
    from hnn_vi_ros.run.saved_state import (
        LAST_STATE_FILE, restore_state, STATE_FILE, state_file)
    from hnn_vi_ros.run.timing import LONGEST_CALL, OverrunGuard, Pacer, StatusLine, TimingFigures

__getattr__, __dir__ = lazy_exports(__name__)
