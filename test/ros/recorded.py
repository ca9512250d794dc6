# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Bags as the simulator records them, made without one."""

from collections.abc import Callable
from pathlib import Path

from hnn_vi_ros.ros.messages import describe_topic, MessageEncoder, TICK_TOPICS
from hnn_vi_ros.ros.sampling import Sampler
from hnn_vi_ros.ros.scene_report import resolved_scene
from hnn_vi_ros.scene import Scene
from hnn_vi_ros.simulation import Simulation
from hnn_vi_ros.sinks.mcap_sink import McapSink
from hnn_vi_ros.sinks.sample import Sample
from hnn_vi_ros.yaml_text import dump_yaml
from rclpy.qos import QoSProfile


def record_run(bag: Path, scene: Scene, ticks: int, rate: float = 100.0,
               change: Callable[[Sample], None] = lambda sample: None, close: bool = True,
               **described: object) -> Path:
    """Record a run; `change` may alter a sample before it is recorded."""
    simulation = Simulation.from_scene(scene)
    simulation.restart(simulation.q.copy(), simulation.p.copy(),
                       step=described.get('first_step', 0))
    sampler = Sampler(simulation, rate)
    encoder = MessageEncoder([c.name for c in simulation.hamiltonian.coordinates])
    topics = [describe_topic(name.replace('~', '/hnn_simulator') if name[0] == '~' else f'/{name}',
                             kind, QoSProfile(depth=10)) for name, kind in TICK_TOPICS]
    attachments = {'scene.yaml': resolved_scene(scene, simulation) | described,
                   'parameters.yaml': {'publish_rate': rate}}
    sink = McapSink(bag, topics, {name: dump_yaml(data).encode()
                                  for name, data in attachments.items()})
    for _ in range(ticks):
        simulation.advance(sampler.every)
        sample = sampler.sample()
        change(sample)
        sink.write(sample.stamp, encoder.encode(sample))
    if close:
        sink.close()
    else:
        sink.flush()
    return bag
