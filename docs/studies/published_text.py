# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Text of docs/learning.md around its tables."""

QUICK_TEXT = """
**From a quick run, which only tests that everything runs: its numbers are meaningless.**
"""
PAGE_TEXT = """\
# Learning

Which model family to train, and how accurate ours are compared with published results. The page is
for users who train models, and for readers who know the papers.

**Main result.** {summary}

`ros2 run hnn_vi_ros published_tables` writes this page, from models trained and measured on
{machine}, one thread each, commit {commit}. All values: [published_tables.csv]({csv}).
{quick}
## Which model to use

| what you have | family | loss | simulate it with |
|---|---|---|---|
| states and their rates, or a log dense enough to differentiate; energy is conserved | `hnn` | \
`vector_field` | any implicit method, see [what accuracy costs](accuracy-and-cost.md); no \
explicit one, because H is not separable |
| the same, and only the kinetic energy depends on p | `separable_hnn` | `vector_field` | the \
explicit `stormer_verlet` too |
| states at even but coarse times, or noisy states | `dgnet` | `discrete_gradient` | \
`discrete_gradient` at the h of the data |
| the same, with linear friction | `dgnet` with friction | `discrete_gradient` | the same, and \
the effect `damping` with the model |
| nonlinear friction | `dissipative_hnn` | `vector_field` | any method with forces, \
and the effect `learned_dissipation` |
| positions only | `vin` | `discrete_lagrangian` | `stormer_verlet` or `implicit_midpoint`, as \
its `rule` says, at the h of the data |
| positions, velocities and accelerations, and no mass matrix | `lagrangian` | \
`euler_lagrange` | any implicit method, or `discrete_euler_lagrange` |
| coordinates that are not canonical, such as q and dq/dt | `symplectic_form` | `vector_field` | \
`variational_midpoint` |
| q, dq/dt and the motor forces of a robot, with friction | `mechanical` | \
`trajectory`; `forward` if accelerations are known | any method with forces, and the \
effects `learned_friction` and `external_force` with the model: [machines](machines.md) |
| commands and momenta, with an unknown map from commands to joints | `control_affine` | \
`vector_field` | the effect \
`external_force` with the model |

A model trained through a scheme (`steps`, `discrete_gradient`, `discrete_lagrangian`) is valid for
that scheme and its h, because it has learned the modified energy of both. Its card says so, and
the simulator warns if it runs with others.

## What a training error means for a simulation

- *Energy.* A symplectic method conserves the learned H over any run, up to a bounded oscillation.
  If the learned H is off by at most e in the training domain, the true energy stays within 2 e
  plus that oscillation, while the motion stays in the domain. The error does not grow with time.
- *Global error.* An error of the field makes the motion early or late, more with each revolution:
  the global error grows in proportion to time, in a chaotic system exponentially. No method can
  prevent that.
- *Noise.* Noise on the states does not average out. A network that is given noisy states learns
  the mean rate of the states they may come from, which lie further inside: a slower system (errors
  in variables). Remedies are to smooth the log before training (`derivatives` in a training
  configuration), to train on differences of states (`dgnet`), and few steps or a small
  `linearity`: long training fits the noise.
- *Losses.* A loss measured at noisy states contains the noise, and says little about the accuracy
  of a simulation: in the second table below the models have a smaller loss than the true H.

## The table of the original HNN

S. Greydanus, M. Dzamba, J. Yosinski, *Hamiltonian Neural Networks*, NeurIPS 2019: mass-spring (H =
q^2 + p^2) and pendulum (H = 3 (1 - cos q) + p^2), each with 25 training and 25 test orbits of 3 s
with noise of 0.1 on each state; and two bodies, with 800 training and 200 test orbits of 20 s
without noise. Seed 0 reproduces the published data, with random numbers in the same order; the
other seeds are other data of the same kind. Ours are of the family `hnn` with two hidden layers of
64 (published: 200), trained by Adam, then L-BFGS.

{hnn_published}

The test loss is close to the minimum that the data permit. Each rate is that of the true state,
but the input of the network is the noisy state. So the loss of the true H is about the noise
itself, and the best function of a noisy state, E[rate | state], has a minimum loss that training
can beat only by chance. Where the mean over seeds of our test loss is above the published number,
so is that minimum: the published number is of one draw.

{hnn_noise}

The accuracy of these models in a simulation, in the units of the system:

{hnn_physics}

The energy error is that of the true H along the simulated orbits, 15 of them over 20 s (two
bodies: 25 s); the path error is the distance from the true orbit over the same time.

## The table of DGNet

T. Matsubara, A. Ishikawa, T. Yaguchi, *Deep Energy-Based Modeling of Discrete-Time Physics*,
NeurIPS 2020: training without rates. The systems are the same, over 20 s at 100 times (two bodies:
25 s at 500), and the models are trained on differences of noisy states. The published values are
means over 15 seeds. Ours are of the family `dgnet`, trained with its discrete gradient and
simulated by `discrete_gradient` at the same h.

{dgnet_published}

{dgnet_physics}

On the real pendulum (M. Schmidt, H. Lipson, Science 324, 2009) the first four fifths of the log
are training data. The model is then simulated freely from the first state of the last fifth, with
its learned friction. The published 4.92e-4 is of a DGNet solved by an adaptive method; with its
own discrete gradient it is 5.04e-4.

## The dissipative HNN on the real pendulum

A. Sosanya, S. Greydanus, *Dissipative Hamiltonian Neural Networks*, 2022, on the same log, with
rates from central differences. Ours are of the family `dissipative_hnn`, simulated by `gauss4`
with the effect `learned_dissipation`.

{dissipative_published}

The measure compares with the log, so it contains the noise of the log. For scale, the table has a
parabola in time, fitted to the energy of the test data themselves.

{real_physics}

## Machines

Models of the family `mechanical`, trained by `train --config NAME` as shipped
(`two_link_arm_characters`, `dfki_double_pendulum`, `multiarm_double_pendulum`,
`two_link_arm_chirps`; rigid body and networks of the free double pendulum by
`multiarm_rigid_body`). Several coordinates have one number each. *Networks* know only which
coordinates are angles; *rigid body and networks* adds `prior: double_pendulum`. *Others* is the
best result published with the data, or a rigid body fitted to them. Of the baselines, the rigid
body is the prior alone with friction, and the plain network is of (q, v, tau), with the same
hidden layers, trained in the same way. Each row gives its number of seeds; a row of one seed
depends on that seed. Missing values were not measured. All values:
[machines.json](learning/machines.json), and by model and seed
[machine_runs.json](learning/machine_runs.json).

{machines}

- *two-link arm that writes letters* (M. Lutter, J. Peters, 2021): the time for which a held-out
  letter is predicted from its first sample, with its forces held over each sample of 0.04 s, until
  sum_i (error of q_i)^2 / var_i reaches 0.01. More is better.
- *real actuated double pendulum* (DFKI, hardware C.1): free simulation with the measured forces
  from a state every 50 ms; the *later* runs are swing-ups of another day.
- *real free double pendulum* (K. Kaheman et al., HardwareX 2023): from the first sample of each
  segment, as recorded; the mean of the errors of the four segments. In the last one the first
  velocities differ from the rates of the positions by 0.10 and 0.13 rad/s, which causes most of
  the error of any model.
- *simulated arm with friction*: the arm of
  [two_joint_arm.urdf](../config/robots/two_joint_arm.urdf) with viscous and dry friction and a
  chirp for the torque of each motor: six training runs of 40 s and four test runs; messages at 250
  Hz, with jitter, 2 % of them lost; positions, velocities and torques quantised. The measure is
  the time for which a run is predicted from its first sample, with its torques, until the error of
  a coordinate reaches 0.4 of its standard deviation; at most 40 s. More is better. There is no
  published value; the target is 20 s. One of the four runs has a larger amplitude than all
  training runs (2.6 rad at the shoulder, against 2.0).

### Robots by their URDF

The family `rigid_body` identifies inertias, friction and offsets, without and with a residual
network; see [identify a robot](identify-robot.md). The network is selected on training data:
models are trained on the first three quarters and compared by their mean error on the last one,
before any test data are used. All are shown. `python -m studies.robot_tables` with
`--data` and, for the UR10, `--ur10`, the URDF of `example-robot-data`, writes the values to
[robots.json](learning/robots.json), and by model to [robot_runs.json](learning/robot_runs.json).

{robots}

- *real UR10*: 27.5 s of excitation; trained on the first 60 %, tested on the last 40 % less 60
  samples; `smoothing: 3`, `loss: inverse`, `friction: {{coulomb: 2}}`. Others: rigid body and
  friction by least squares.
- *real actuated double pendulum*: as above, from a URDF of two rods of 0.6 kg, `loss: trajectory`,
  `friction: {{coulomb: 2}}`.

## How the published measures are defined

As in the papers' public code:

- *test loss*: the mean over all test states and components of the squared difference between the
  field at the noisy state and the rate at the true one.
- *published energy MSE*: the mean over instants and orbits of the squared difference between the
  energies of the simulated and of the true orbit at the same instant. For mass-spring **and
  pendulum** the public code uses q^2 + p^2 as the energy. For the pendulum this is not the energy:
  it varies along every orbit, and its difference mostly shows a phase error. The errors of the
  true H are in the other tables. For the two bodies it is H. For the real pendulum it is 2.4 (1 -
  cos q) + v^2, where 2.4 is a fit.
- The energy of mass-spring and pendulum is measured on 15 orbits over 20 s at 100 instants, which
  begin at abs(q) and abs(p) of 0.2 to 1. They are drawn after the data from the same generator, as
  in the public code of DGNet; the orbits of the HNN's table are not documented. We do not stretch
  the model's time by 1 + 0.9 noise, as copies of the original notebook do to compensate the bias
  of the noise.
- The two bodies begin at the 15 states of seeds 0 to 14. The horizon of the HNN's table is not
  documented; ours is 25 s at 500 instants, as in the table of DGNet, longer than the 20 s of the
  training data.
- The friction of the published DGNet acts on H_p, ours on p.
- The spread is the standard deviation over seeds. *At or below* compares three digits, as
  published, for seed 0 and for the mean.

Widths, numbers of steps and weights are in
[published_tables.yaml](studies/published_tables.yaml). They were tuned by hand with
seeds 0 to 9 and 101 to 105 in view, so these seeds are not independent of the choice. We may not
distribute the log of the real pendulum: `--data DIR` gives its folder, and without it those rows
say *not measured*.
"""
