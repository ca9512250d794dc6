# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""A trajectory in the rerun viewer."""

from pathlib import Path

from hnn_vi_ros.mechanisms import MECHANISMS
from hnn_vi_ros.simulation.sample import Sample
from hnn_vi_ros.trajectory.data import TrajectoryData
from hnn_vi_ros.viewer.rerun_sink import RerunSink


def record(trajectory: TrajectoryData, target: str | Path | int) -> None:
    """Send what ``Trajectory.to_rerun`` tells."""
    run, simulation = trajectory.single(), trajectory.simulation()
    scene = run.scene
    hamiltonian = simulation.hamiltonian
    assert scene is not None, 'it has a Hamiltonian'
    if isinstance(target, str) and '://' not in target:
        target = Path(target)
    h, first = scene.known_step_size, float(run.energy[0])
    stamps = [round(t * 1e9) for t in run.t.tolist()]
    dH_dq, dH_dp = hamiltonian.gradient(run.q, run.p)
    # The work of effects is not part of a trajectory: its error is that of H alone.
    sink = RerunSink(
        scene.name, target, hamiltonian, run.q[0], run.p[0], box=hamiltonian.box,
        mechanism=MECHANISMS[scene.mechanism] if scene.mechanism else None,
        effects=simulation.effects, step_size=h, modified=False,
        interval=0, begin=(stamps[0], round(run.t[0] / h)))
    try:
        told = [(event.t, f'event {event}', 'INFO') for event in run.events] + [
            (alarm.step * h, alarm.message, 'WARN') for alarm in run.alarms]
        for t, text, level in sorted(told):
            sink.event(text, level, (round(t * 1e9), round(t / h)))
        for k, stamp in enumerate(stamps):
            energy = float(run.energy[k])
            sink.write(Sample(
                round(run.t[k] / h), stamp, run.q[k], run.p[k], dH_dq[k], dH_dp[k], energy,
                float('nan'), (energy - first) / (abs(first) or 1.0)))
    finally:
        sink.close()
