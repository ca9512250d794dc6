# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Episodes of a sweep as bags in the format that the simulator records."""

from collections.abc import Iterator
from pathlib import Path

from hnn_vi_ros.errors import RecordingError
from hnn_vi_ros.files import dump_yaml
from hnn_vi_ros.recording import McapSink, serialize, Topic
from hnn_vi_ros.ros.topics.messages import describe_topic
from hnn_vi_ros.ros.topics.outputs import encode_sample, SAMPLED, SCENE
from hnn_vi_ros.run import scene_report, STATE_FILE, state_file
from hnn_vi_ros.sweeps import Episode, running, SweepPlan
from rclpy.qos import QoSProfile
from std_msgs.msg import String

_NODE = '/hnn_simulator'


def main(argv: list[str]) -> int:
    """Run ``sweep`` with a command line that requests bags."""
    return running.main(argv, write_bags)


def write_bags(plan: SweepPlan, episodes: Iterator[Episode], folder: Path) -> None:
    """
    Write each episode as a bag in a folder, named like ``episode-000007``.

    A bag holds the topics that the simulator would record for the scene with the values of the
    episode: ``replay`` publishes it and ``replay --verify`` confirms it. The varied values are
    in its scene and in its attachment ``sweep.yaml``.

    Parameters
    ----------
    plan : SweepPlan
        Plan of the sweep.
    episodes : iterator of Episode
        Trajectories of the sweep.
    folder : Path
        Folder for the bags; none of them may exist.

    Raises
    ------
    RecordingError
        A bag already exists or cannot be written, or the scene has measurements.

    """
    topics = [_topic(*output[:3]) for output in SAMPLED]
    for episode in episodes:
        _, values, scene, simulation, sampler, _ = episode
        if scene.measurements is not None:
            raise RecordingError(f'{scene.place("measurements")}: bags of sweeps hold the true '
                                 'state only; remove measurements')
        report = dump_yaml(scene_report(scene, simulation))
        sink = McapSink(folder / f'episode-{episode.number:06d}', topics, {
            'scene.yaml': report.encode(),
            'parameters.yaml': dump_yaml({'publish_rate': 1.0 / sampler.tick}).encode(),
            'sweep.yaml': dump_yaml({
                **plan.record['sweep'], 'index': episode.number, 'values': values}).encode(),
            # The noise of an episode differs from that of a separate run of the scene.
            STATE_FILE: state_file(simulation)})
        sink.write_other(_topic(*SCENE[:3]), sampler.stamp, serialize(String(data=report)))
        encode = encode_sample(simulation.hamiltonian.coordinates)
        for sample in episode.samples():
            sink.write(sample.stamp, encode(sample))
        sink.close()


def _topic(name: str, kind: type, qos: QoSProfile) -> Topic:
    """Describe a topic of the simulator, under its name without a namespace."""
    full = name.replace('~', _NODE) if name.startswith('~') else f'/{name}'
    return describe_topic(full, kind, qos)
