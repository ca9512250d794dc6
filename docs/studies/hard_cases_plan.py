# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""The hard cases of hard_cases.yaml and their rows."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from hashlib import sha256
from pathlib import Path
from typing import Annotated, Any, Literal

from hnn_vi_ros.effects import Effect
from hnn_vi_ros.errors import ParameterError, UnsupportedSystem
from hnn_vi_ros.files import read_yaml, StrictModel
from hnn_vi_ros.hamiltonians import Hamiltonian
from hnn_vi_ros.integrators import Integrator, INTEGRATORS
from hnn_vi_ros.scene import Scene
from hnn_vi_ros.simulation import Simulation
from pydantic import Field
from studies.variants import create

EXACT, LEARNED = 'exact', 'learned'
_ROBOTS = Path(__file__).resolve().parents[2] / 'config' / 'robots'
# The paper's plain iteration, without the chain of solvers behind it.
_FIXED_POINT = '@fixed_point'

Positive = Annotated[float, Field(gt=0.0)]
Steps = Annotated[int, Field(ge=100)]


class Guards(StrictModel):
    """Limits of the guards, over the energies in play; see hnn_vi_ros.simulation.guards."""

    under_resolved: Positive
    drift: Positive


class Methods(StrictModel):
    """Methods that run, where a set-up does not say otherwise."""

    exact: list[str]
    learned: list[str]
    quick_exact: list[str]
    quick_learned: list[str]


class SetUp(StrictModel):
    """One start of a case; Hamiltonian and effects as in a scene."""

    name: str = ''
    hamiltonian: dict[str, Any]
    effects: list[dict[str, Any]] = []
    q: list[float]
    p: list[float]
    step_size: Positive
    methods: list[str] | None = None
    quick_methods: list[str] | None = None
    steps: Steps | None = None
    quick_steps: Steps | None = None
    saddles: list[list[float]] = Field([], description='states (q, p) next to those of a barrier')
    inside: Literal['swing', 'triangle'] | None = Field(None, description=(
        'where q must stay'))
    events: list[str] = Field([], description=(
        'conditions, such as x = 0, that must come true as often as by DOP853'))
    within: int | None = Field(None, description=(
        'steps after which a symplectic method that is not stable must have said so'))

    @property
    def kind(self) -> str:
        """Return whether H is exact or learned."""
        return LEARNED if self.hamiltonian['kind'] in ('hnn', 'learned') else EXACT


class Case(StrictModel):
    """One hard case."""

    number: int
    title: str
    claim: str
    check: Literal['motion', 'dissipation', 'constraint', 'repeatability', 'counts',
                   'books', 'paths'] = 'motion'
    gates: list[Literal['G1', 'G2', 'G3', 'G4', 'G5']] = ['G1', 'G2', 'G3', 'G4', 'G5']
    steps: Steps = 1_000_000
    quick_steps: Steps
    barrier: str = ''
    measure: Literal['angular momentum', 'gradients', 'Lyapunov time', 'drift', ''] = ''
    at_most: Positive | None = Field(None, description='of the measure, whatever is measured')
    without: str = Field('', description='why there is no exact or no learned row')
    set_ups: list[SetUp] = Field(min_length=1)


class Plan(StrictModel):
    """The schema of hard_cases.yaml."""

    guards: Guards
    methods: Methods
    cases: list[Case]


@dataclass(frozen=True)
class Job:
    """
    Job that one row of the table is measured by.

    Parameters
    ----------
    case, set_up : Case, SetUp
        Case and set-up of the plan.
    method : str
        A name of INTEGRATORS, or ``name@float32`` or ``name@fixed_point``.
    steps : int
        Number of steps.
    guards : Guards
        Their limits.

    """

    case: Case
    set_up: SetUp
    method: str
    steps: int
    guards: Guards

    @property
    def key(self) -> tuple[int, str, str, str]:
        """Return the key of the row, unique within a run."""
        return self.case.number, self.set_up.name, self.set_up.kind, self.method

    @cached_property
    def digest(self) -> str:
        """Return a checksum of the row's inputs, the model among them, without the code."""
        others = {'title', 'claim', 'without', 'set_ups', 'steps', 'quick_steps', 'methods',
                  'quick_methods'}
        parts = (self.case.model_dump(exclude=others), self.set_up.model_dump(exclude=others),
                 self.method, self.steps, self.guards.model_dump(),
                 self.scene().create_hamiltonian().provenance)
        return sha256(repr(parts).encode()).hexdigest()

    @property
    def kernel(self) -> tuple[str, str, str]:
        """Return a key that is equal for jobs with the same compiled code."""
        effects = ','.join(effect['kind'] for effect in self.set_up.effects)
        return self.method, self.set_up.hamiltonian['kind'], effects

    def scene(self) -> Scene:
        """Return the set-up as a scene; its integrator is not the method."""
        hamiltonian = dict(self.set_up.hamiltonian)
        if 'file' in hamiltonian:
            hamiltonian['file'] = str(_ROBOTS / hamiltonian['file'])
        return Scene.model_validate({
            'hamiltonian': hamiltonian, 'effects': self.set_up.effects,
            'integrator': {'kind': 'variational_euler'}, 'step_size': self.set_up.step_size,
            'initial_state': {'q': self.set_up.q, 'p': self.set_up.p}})

    def parts(self) -> tuple[Hamiltonian, Integrator, list[Effect]]:
        """Return Hamiltonian, method and effects; UnsupportedSystem if they do not fit."""
        scene = self.scene()
        hamiltonian = scene.create_hamiltonian()
        if self.method.endswith(_FIXED_POINT):
            integrator = INTEGRATORS[self.method.removesuffix(_FIXED_POINT)](solver='fixed_point')
        else:
            hamiltonian, integrator = create(self.method, hamiltonian)
        return hamiltonian, integrator, scene.create_effects()

    def simulation(self) -> Simulation:
        """Return the simulation in its initial state; UnsupportedSystem if there is none."""
        hamiltonian, integrator, effects = self.parts()
        return Simulation(hamiltonian, integrator, self.set_up.step_size, self.set_up.q,
                          self.set_up.p, effects)


def load_plan() -> Plan:
    """Read the plan; a ParameterError names file, line and key."""
    return read_yaml(Path(__file__).with_name('hard_cases.yaml'), Plan, ParameterError)[0]


def make_jobs(plan: Plan, quick: bool, numbers: Sequence[int] | None = None) -> list[Job]:
    """
    Return a job for every row, without the methods that refuse their system.

    Parameters
    ----------
    plan : Plan
        The cases.
    quick : bool
        Short runs of few methods, or all of them.
    numbers : sequence of int, optional
        Numbers of the cases; all by default.

    Raises
    ------
    ParameterError
        A case number is unknown.

    """
    known = [case.number for case in plan.cases]
    for number in numbers or []:
        if number not in known:
            raise ParameterError(f'--case {number}: no such case; valid: {known[0]} to '
                                 f'{known[-1]}')
    return [job for case in plan.cases if not numbers or case.number in numbers
            for set_up in case.set_ups
            for job in _jobs(plan, case, set_up, quick)]


def _jobs(plan: Plan, case: Case, set_up: SetUp, quick: bool) -> Iterator[Job]:
    methods = getattr(plan.methods, set_up.kind) if set_up.methods is None else set_up.methods
    steps = set_up.steps or case.steps
    if quick:
        few = getattr(plan.methods, f'quick_{set_up.kind}')
        methods = ([method for method in methods if method in few]
                   if set_up.quick_methods is None else set_up.quick_methods)
        steps = set_up.quick_steps or case.quick_steps
    for method in methods:
        job = Job(case, set_up, method, steps, plan.guards)
        try:
            job.simulation()
        except UnsupportedSystem:
            continue
        yield job
