# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Work of the simulator's node for each sample, without the executor."""

from hnn_vi_ros.recording import Sample
from hnn_vi_ros.ros import settings as parameters
from hnn_vi_ros.ros.recording import RunRecording
from hnn_vi_ros.ros.topics.outputs import ConfiguredRun
from hnn_vi_ros.ros.topics.topics import Topics
from hnn_vi_ros.run import Monitor, preview_bounds, Sampler, scene_report
from hnn_vi_ros.scene import Scene
from hnn_vi_ros.simulation import make_guards, RunFacts, Simulation
from rclpy.node import Node

_LIMITS = 0.05, 0.02


class Ticks:
    """
    Ticks of a node that publishes and records every step.

    Parameters
    ----------
    node : Node
        Publishing node.
    scene : Scene
        Scene of the simulation.
    simulation : Simulation
        Simulation of the scene.
    sampler : Sampler
        Samples every step.
    recording : mapping
        Parameters of the files.
    watched : bool
        True to run the guards.

    """

    def __init__(self, node: Node, scene: Scene, simulation: Simulation, sampler: Sampler,
                 recording: dict[str, str], watched: bool):
        box, facts = preview_bounds(simulation, 1.0), RunFacts(simulation, *_LIMITS)
        self.sampler, self.topics = sampler, Topics(node, parameters.Settings())
        guards = make_guards(facts)
        self.monitor = Monitor(simulation, sampler.every, sampler.tick, None,
                               lambda text, first: None, guards if watched else (), facts.scale)
        self.topics.open(ConfiguredRun(simulation, self.monitor, box, scene.mechanism), lambda: 0,
                         lambda topic, stamp, payload: None)
        self.recording = RunRecording(
            node.get_logger(), scene, simulation, parameters.Settings(**recording),
            self.topics.descriptions, box, scene_report(scene, simulation), sampler)

    def tick(self) -> tuple[Sample, bool]:
        """Take a step, publish and record it; return the sample, and whether figures are due."""
        self.monitor.advance(self.sampler.every)
        sample = self.sampler.sample()
        self.monitor.add(sample)
        self.recording.write(sample, self.topics.publish(sample))
        return sample, self.monitor.evaluate()
