# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""
Our planners next to crocoddyl's BoxFDDP and pytorch_mppi, all over the same BatchStep.

The swing-up of an acrobot from rest, with the costs of real_ai_gym, from the same first commands.
It needs crocoddyl and pytorch_mppi.

    cd docs && ../.venv/bin/python -m benchmarks.planners
"""

import time
from typing import Any

from benchmarks.real_ai_gym import ilqr, NUMBERS, PERIOD, scene_of, TORQUE
from hnn_vi_ros.control import BatchStep, Ilqr, Mppi
import numpy as np

HORIZON = 55


def action(planner: Ilqr, final: bool) -> Any:
    """Return crocoddyl's action model of a step of a planner's model, or of the end."""
    import crocoddyl

    class Action(crocoddyl.ActionModelAbstract):
        """A step, or the end."""

        def __init__(self) -> None:
            super().__init__(crocoddyl.StateVector(4), 1, 1)
            self.u_lb, self.u_ub = np.array([-TORQUE]), np.array([TORQUE])

        def calc(self, data: Any, x: np.ndarray, u: np.ndarray | None = None) -> None:
            if final or u is None:
                data.cost = float(planner._final.value(x, np.zeros(1)))
                return
            data.xnext = planner._steps(x, u)
            data.cost = float(planner._running.value(x, u))

        def calcDiff(self, data: Any, x: np.ndarray, u: np.ndarray | None = None) -> None:
            if final or u is None:
                cost = planner._final.expand(x[None], np.zeros((1, 1)))
            else:
                cost = planner._running.expand(x[None], u[None])
                _, data.Fx, data.Fu = planner._steps.derivatives(x, u)
                data.Lu, data.Luu = cost.by_u[0], np.array(cost.by_uu[0])
            data.Lx, data.Lxx = cost.by_z[0], cost.by_zz[0]
    return Action()


def timed(what: str, call: Any, cost: Any, times: int = 5) -> None:
    """Print the least processor time of a call, and the cost of its plan."""
    spent = []
    for _ in range(times):
        started = time.thread_time()
        result = call()
        spent.append(time.thread_time() - started)
    print(f'{what:40s} {1e3 * min(spent):8.2f} ms   cost {cost(result):.3f}', flush=True)


def main() -> None:
    """Print a table."""
    scene = scene_of('acrobot', PERIOD, 'rk4', NUMBERS)
    planner = ilqr(scene, 1, HORIZON, np.inf, restarts=0, refined=1)
    rng = np.random.default_rng(0)
    guess = np.repeat(rng.uniform(-TORQUE, TORQUE, (6, 1)), 10, axis=0)[:HORIZON]
    start = np.zeros(4)

    def ours(iterations: int) -> float:
        plan = planner._rolled(start, guess[None], 0.0)[0]
        for _ in range(iterations):
            if not plan.done:
                planner._improve([plan], 0.0)
        return plan.cost
    for iterations in (5, 20, 60):
        timed(f'Ilqr, {iterations} iterations', lambda n=iterations: ours(n), float)
    import crocoddyl
    problem = crocoddyl.ShootingProblem(start, [action(planner, False)] * HORIZON,
                                        action(planner, True))

    def theirs(iterations: int) -> Any:
        solver = crocoddyl.SolverBoxFDDP(problem)
        states = planner._steps.rollout(start, guess[None])[0][0]
        solver.solve([*states], [*guess], iterations, False)
        return solver
    for iterations in (5, 20, 60):
        timed(f'crocoddyl BoxFDDP, {iterations} iterations', lambda n=iterations: theirs(n),
              lambda solver: planner._rolled(start, np.clip(np.array(solver.us), -TORQUE, TORQUE)[
                  None], 0.0)[0].cost, 2)
    paths(planner, start, guess)


def paths(planner: Ilqr, start: np.ndarray, guess: np.ndarray) -> None:
    """Compare Mppi with pytorch_mppi: one call of 256 plans."""
    import torch
    from pytorch_mppi import MPPI
    torch.set_num_threads(1)
    steps: BatchStep = planner._steps
    own = Mppi(steps, planner._running, planner._final, HORIZON, ([-TORQUE], [TORQUE]), [2.0],
               1.0, samples=256, knots=HORIZON)
    own([0.0, 0.0], [0.0, 0.0], 0.0)

    def ours() -> float:
        own._last = planner._rolled(start, guess[None], 0.0)[0]
        own([0.0, 0.0], [0.0, 0.0], 0.0)
        return own.cost
    timed('Mppi, 256 plans', ours, float)

    def dynamics(z: Any, u: Any) -> Any:
        return torch.from_numpy(steps(z.numpy(), u.numpy()))

    def running(z: Any, u: Any) -> Any:
        return torch.from_numpy(planner._running.value(z.numpy(), u.numpy()))

    def final(z: Any, u: Any) -> Any:
        last = z[..., -1, :].numpy()
        return torch.from_numpy(planner._final.value(last, np.zeros((*last.shape[:-1], 1))))

    def theirs() -> float:
        mppi = MPPI(dynamics, running, 4, torch.tensor([[4.0]], dtype=torch.double),
                    num_samples=256, horizon=HORIZON, lambda_=1.0, terminal_state_cost=final,
                    u_min=torch.tensor([-TORQUE], dtype=torch.double),
                    u_max=torch.tensor([TORQUE], dtype=torch.double),
                    U_init=torch.from_numpy(guess.copy()))
        mppi.command(torch.zeros(4, dtype=torch.double), shift_nominal_trajectory=False)
        return planner._rolled(start, mppi.U.numpy()[None], 0.0)[0].cost
    timed('pytorch_mppi, 256 plans', theirs, float)


if __name__ == '__main__':
    main()
