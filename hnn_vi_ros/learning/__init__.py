# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""
Training: measured data, model families in torch, fits, evaluation, model files.

``data`` reads logs and bags, ``families`` contains the networks, ``fit`` the losses and loops, and
``tasks`` combines them for ``hnn train``. Fitting parameters of a scene is in ``identify``;
compiled networks are in ``models``.
"""

from typing import TYPE_CHECKING

from hnn_vi_ros.exports import lazy_exports

if TYPE_CHECKING:
    from hnn_vi_ros.learning.arguments import add_config, Course, INPUTS
    from hnn_vi_ros.learning.data.arrays import ArraysData, keys_of, split_runs
    from hnn_vi_ros.learning.data.header import ANGLE, read_header
    from hnn_vi_ros.learning.data.log_warnings import LogWarning, warnings_of
    from hnn_vi_ros.learning.data.motions import even_motions, EvenMotion, joined, Motion, run_of
    from hnn_vi_ros.learning.data.sampling import low_pass, steps_between
    from hnn_vi_ros.learning.data.sources import (
        configuration_of, MotionSource, read_motions, recording_of, source_of)
    from hnn_vi_ros.learning.export_module import export
    from hnn_vi_ros.learning.fit.config import family_schemas, load_machine
    from hnn_vi_ros.learning.fit.excitation import ExcitationData
    from hnn_vi_ros.learning.fit.following import LogSimulation
    from hnn_vi_ros.learning.fit.growing import (
        first_length, fit_numbers, FittedNumbers, judged, refitted)
    from hnn_vi_ros.learning.fit.input_courses import (
        EVIDENCE, evidence_of, input_courses, InputCourses)
    from hnn_vi_ros.learning.fit.noise import covariances, Process, processes
    from hnn_vi_ros.learning.fit.prediction import predicted_by, Prediction
    from hnn_vi_ros.learning.fit.shooting import (
        column_norms, FitProblem, least_squares_factors, made_up, projected, search, Solution,
        units_of)
    from hnn_vi_ros.learning.fit.step_forces import held_commands, HeldCommands
    from hnn_vi_ros.learning.fit.windows import (
        CannotFollow, check_times, DELAY, MeasuredColumns, ModelParts, Number, refusals, Windows)

__getattr__, __dir__ = lazy_exports(__name__)
