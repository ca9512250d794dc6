# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""A bag against its own run simulated again, and a run that goes on from a bag."""

from hnn_vi_ros import load_scene
from hnn_vi_ros.errors import HnnViRosError, RecordingError
from hnn_vi_ros.identity import identity
from hnn_vi_ros.ros import verification
from hnn_vi_ros.ros.recorded_run import RecordedRun, resume
from hnn_vi_ros.ros.verification import verify
from hnn_vi_ros.simulation import Simulation
import numpy as np
from processes import finish, start_executable
import pytest
from recorded import record_run

# Learned and exact, implicit, driven in time, with noise.
SCENES = ('harmonic_oscillator', 'exact_double_pendulum', 'damped_driven_pendulum',
          'brownian_oscillator')


@pytest.mark.parametrize('name', SCENES)
def test_bag_agrees_bit_by_bit_with_its_run_simulated_again(tmp_path, name):
    bag = record_run(tmp_path / 'bag', load_scene(name), 100)
    assert RecordedRun(bag).reader.metadata('hnn_vi_ros') == identity()
    verdict = verify(bag)
    assert verdict.good
    assert '100 samples agree bit by bit, on the machine' in verdict.text


def shift(stamp: int, size: float):
    """Return what changes the last coordinate from a stamp on, as another path would."""
    def change(sample):
        if sample.stamp >= stamp:
            sample.q[-1] += size * max(1.0, abs(sample.q[-1]))
    return change


@pytest.fixture
def elsewhere(monkeypatch):
    """Let this machine be another than that of the logs."""
    monkeypatch.setattr(verification, 'identity', lambda: identity() | {'processor': 'another'})


def test_difference_on_the_same_machine_is_named_and_not_good(tmp_path):
    bag = record_run(tmp_path / 'bag', load_scene('exact_double_pendulum'), 100,
                     change=shift(500_000_000, 1e-15))
    verdict = verify(bag)
    assert not verdict.good
    assert '49 samples agree bit by bit' in verdict.text
    assert ' differs at t = 0.5 s by ' in verdict.text
    assert 'within what round-off explains' in verdict.text
    assert '\n' not in verdict.text


@pytest.mark.parametrize('size, within', [(1e-15, True), (1e-9, False)])
def test_difference_elsewhere_is_good_within_round_off_alone(tmp_path, elsewhere, size, within):
    bag = record_run(tmp_path / 'bag', load_scene('exact_double_pendulum'), 100,
                     change=shift(500_000_000, size))
    verdict = verify(bag)
    assert verdict.good == within
    assert ('is within' if within else 'is beyond') in verdict.text
    assert f'processor is {identity()["processor"]}' in verdict.text


def test_agreement_elsewhere_says_so(tmp_path, elsewhere):
    verdict = verify(record_run(tmp_path / 'bag', load_scene('exact_pendulum'), 20))
    assert verdict.good and 'elsewhere than the log' in verdict.text


def test_log_of_another_model_is_refused(tmp_path):
    scene = load_scene('harmonic_oscillator')
    provenance = Simulation.from_scene(scene).hamiltonian.provenance
    name = next(iter(provenance))
    bag = record_run(tmp_path / 'bag', scene, 5, **{name: 'another'})
    with pytest.raises(RecordingError, match=f'another model: its {name} is another'):
        verify(bag)


def test_log_whose_stamps_are_no_whole_steps_is_refused(tmp_path):
    bag = record_run(tmp_path / 'bag', load_scene('exact_pendulum'), 5, origin=1)
    with pytest.raises(HnnViRosError, match='no whole number of steps'):
        verify(bag)


@pytest.mark.parametrize('name', ['exact_double_pendulum', 'exact_damped_driven_pendulum'])
def test_run_resumed_from_a_log_goes_on_as_the_unbroken_one(tmp_path, name):
    scene = load_scene(name)
    whole = record_run(tmp_path / 'whole', scene, 200)
    bag = record_run(tmp_path / 'bag', scene, 100, close=False)
    resumption = resume(bag)
    simulation = resumption.simulation()
    run = RecordedRun(whole)
    samples = list(run.samples())
    assert resumption.step == run.step_of(samples[99][0]) == simulation.steps
    assert np.array_equal(simulation.q, samples[99][1])
    assert np.array_equal(simulation.p, samples[99][2])
    assert resumption.parameters == {'publish_rate': 100.0}
    for stamp, q, p in samples[100:]:
        simulation.advance(run.step_of(stamp) - simulation.steps)
        # No solver memory is kept: equal to the implicit equation's round-off, which grows.
        assert np.allclose(simulation.q, q, rtol=0.0, atol=1e-10)
        assert np.allclose(simulation.p, p, rtol=0.0, atol=1e-10)


def test_resumed_log_is_verified_from_its_own_first_step(tmp_path):
    scene = load_scene('exact_damped_driven_pendulum')
    resumption = resume(record_run(tmp_path / 'bag', scene, 100))
    second = record_run(tmp_path / 'second', resumption.scene, 50, first_step=resumption.step)
    verdict = verify(second)
    assert verdict.good and '50 samples agree bit by bit' in verdict.text
    assert resume(second).step == resumption.step + 50 * resumption.step // 100
    # As if the first step were forgotten: the drive would be out of step.
    with pytest.raises(RecordingError, match='no whole number of steps'):
        verify(record_run(tmp_path / 'third', resumption.scene, 5, first_step=resumption.step,
                          origin=10**12))


def test_bag_without_states_or_scene_cannot_be_resumed(tmp_path):
    for bag in (tmp_path / 'nothing', tmp_path):
        with pytest.raises(RecordingError) as caught:
            resume(bag)
        assert '\n' not in str(caught.value)


def test_verify_option_tells_the_verdict_and_its_status(tmp_path):
    bag = record_run(tmp_path / 'bag', load_scene('exact_pendulum'), 20)
    status, out, error = finish(start_executable('replay', bag, '--verify'), 120.0)
    assert (status, error) == (0, '')
    assert '20 samples agree bit by bit' in out
