# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""The runs of the published tables: one model of one seed, trained and measured."""

from collections.abc import Iterator
from pathlib import Path
import time

from hnn_vi_ros.files import StrictModel
import numpy as np
from pydantic import Field
from studies import published_pendulum
from studies.published_data import (
    ORBITS, Orbits, PENDULUM, Plane, SPRING, TWO_BODY, TWO_BODY_ORBITS)
from studies.published_measures import (
    exact_loss, field_error, least_loss, METHOD, orbit_errors, published_loss, STEP)
from studies.published_models import (
    Model, train_on_differences, train_on_rates, Training)
from studies.published_page import REAL

TRIALS = 15
PLANES = {'mass_spring': SPRING, 'pendulum': PENDULUM}
# Duration [s] and samples of the two bodies' orbits: of the data of each table, and of every test.
_TWO_BODY_DATA = {'hnn': (20.0, 50), 'dgnet': (25.0, 500)}
_TWO_BODY_TEST = (25.0, 500)

Measures = Iterator[tuple[str, float]]


class Plan(StrictModel):
    """Trainings by table and system; the schema of published_tables.yaml."""

    hnn: dict[str, Training] = Field(description='Greydanus et al. 2019')
    dgnet: dict[str, Training] = Field(description='Matsubara et al. 2020')
    dissipative_hnn: dict[str, Training] = Field(description='Sosanya and Greydanus 2022')

    def quick(self) -> 'Plan':
        """Return one seed and a few steps of each model."""
        return Plan(**{table: {name: training.quick() for name, training in systems.items()}
                       for table, systems in self})

    def without_real_pendulum(self) -> 'Plan':
        """Return the models that need no measured data."""
        return Plan(**{table: {name: training for name, training in systems.items()
                               if name != REAL} for table, systems in self})


def run_table(table: str, system: str, training: Training, seed: int, log: Path) -> Measures:
    """
    Train one model and yield its measures.

    Parameters
    ----------
    table, system : str
        As in the plan.
    training : Training
        Settings of the training.
    seed : int
        Seed of data, choice, split and initial weights.
    log : Path
        The measured log of the real pendulum, where the system is that.

    """
    start = time.perf_counter()
    if system == REAL:
        yield from _real_run(table, training, seed, log)
    elif system in PLANES:
        yield from _plane_run(table, PLANES[system], training, seed)
    else:
        yield from _two_body_run(table, training, seed)
    yield 'seconds', time.perf_counter() - start


def _train(table: str, training: Training, orbits: Orbits, seed: int) -> Model:
    if table == 'dgnet':
        return train_on_differences(training, orbits, seed)
    return train_on_rates(training, orbits, seed)


def _plane_run(table: str, plane: Plane, training: Training, seed: int) -> Measures:
    random = np.random.RandomState(seed)
    duration, samples = (20.0, 100) if table == 'dgnet' else (3.0, round(3.0 * plane.rate))
    learn, test = plane.orbits(random, duration, samples, training.orbits or ORBITS).halves()
    model = _train(table, training, learn, seed)
    yield 'test loss', published_loss(model, test)
    yield 'field error', field_error(model, test)
    if table == 'hnn':
        yield 'test loss of the true H', exact_loss(plane, test)
        yield 'least test loss', least_loss(plane, test)
    starts, t = plane.starts(random, TRIALS), np.linspace(0.0, 20.0, 100)
    yield from orbit_errors(plane, model, starts, t, *_method(table, t)).items()


def _two_body_run(table: str, training: Training, seed: int) -> Measures:
    orbits = TWO_BODY.orbits(np.random.RandomState(seed), *_TWO_BODY_DATA[table],
                             training.orbits or TWO_BODY_ORBITS)
    tested = len(orbits.clean) // 5
    test, learn = orbits.part(slice(0, tested)), orbits.part(slice(tested, None))
    model = _train(table, training, learn, seed)
    yield 'test loss', published_loss(model, test)
    yield 'field error', field_error(model, test)
    starts = np.stack([TWO_BODY.start(np.random.RandomState(i)) for i in range(TRIALS)])
    t = np.linspace(0.0, *_TWO_BODY_TEST)
    yield from orbit_errors(TWO_BODY, model, starts, t, *_method(table, t)).items()


def _real_run(table: str, training: Training, seed: int, log: Path) -> Measures:
    t, z = published_pendulum.read(log)
    if table == 'dgnet':
        learn, test = published_pendulum.split_for_dgnet(t, z)
        model, method = train_on_differences(training, learn, seed, True), 'discrete_gradient'
    else:
        learn, test = published_pendulum.split_for_dissipative_hnn(t, z)
        model, method = train_on_rates(training, learn, seed, 'dissipative_hnn'), 'gauss4'
    yield 'published energy MSE', test.energy_error(model, method)
    yield 'least energy MSE', test.least_error()
    yield 'path error', test.path_error(model, method)


def _method(table: str, t: np.ndarray) -> tuple[str, float]:
    """Return method and step of a table's models: DGNets use the map of their training."""
    return ('discrete_gradient', float(t[1])) if table == 'dgnet' else (METHOD, STEP)
