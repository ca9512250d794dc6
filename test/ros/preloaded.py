# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""
Imports and kernels of the process that executables are forked from; see executables.

Neither rclpy nor rerun is imported: they start threads, which a fork would lose.
"""

from importlib import import_module
import inspect

from hnn_vi_ros import load_scene
from hnn_vi_ros.run import Monitor, Sampler
from hnn_vi_ros.simulation import build, make_guards, RunFacts

# Each fork runs the main module of the tests again, which imports pytest.
for name in ('pytest', 'hnn_vi_ros.recording.bags.mcap_sink', 'hnn_vi_ros.control.planning',
             'hnn_vi_ros.ros.arguments', 'hnn_vi_ros.run.report', 'diagnostic_msgs.msg',
             'lifecycle_msgs.srv', 'nav_msgs.msg', 'rcl_interfaces.srv', 'sensor_msgs.msg',
             'std_srvs.srv', 'trajectory_msgs.msg', 'visualization_msgs.msg'):
    import_module(name)
simulation = build(load_scene('exact_harmonic_oscillator'))
simulation.compile_rescue()
facts = RunFacts(simulation)
monitor = Monitor(simulation, 1, 0.01, None, lambda text, first: None,
                  make_guards(facts), facts.scale)
monitor.watch(Sampler(simulation, 100.0).sample())
monitor.advance(1)
# The first line of a log looks up the file of each module, which inspect remembers.
inspect.getmodule(inspect.currentframe())
