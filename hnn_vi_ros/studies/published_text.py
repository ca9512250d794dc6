# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Text of docs/learning.md around its tables."""

QUICK_TEXT = """
**From a quick run, which only shows that everything runs: its numbers mean nothing.**
"""
PAGE_TEXT = """\
# Learning

Written by `ros2 run hnn_vi_ros published_tables`, from models trained and measured on {machine},
one thread each, commit {commit}. Every value: [published_tables.csv]({csv}).
{quick}
{summary}

## Which model to take

| what you have | family | loss | simulate it with |
|---|---|---|---|
| states and their rates, or a log dense enough to differentiate; energy is kept | `hnn` | \
`vector_field` | any implicit method, see [what accuracy costs](accuracy-and-cost.md); no \
explicit one, for its H is not separable |
| the same, and p enters in the kinetic energy alone | `separable_hnn` | `vector_field` | the \
explicit `stormer_verlet` too |
| states at even, coarse instants, or noisy ones | `dgnet` | `discrete_gradient` | \
`discrete_gradient` at the h of the data |
| the same, with linear friction | `dgnet` with friction | `discrete_gradient` | the same, and \
the effect `damping` with the model |
| friction of another kind | `dissipative_hnn` | `vector_field` | any method that takes forces, \
and the effect `learned_dissipation` |
| positions only | `vin` | `discrete_lagrangian` | `stormer_verlet` or `implicit_midpoint`, as \
its `rule` says, at the h of the data |
| positions, velocities and accelerations, and no mass matrix | `lagrangian` | \
`euler_lagrange` | any implicit method, or `discrete_euler_lagrange` |
| coordinates that are not canonical, such as q and dq/dt | `symplectic_form` | `vector_field` | \
`variational_midpoint` |
| what a robot publishes, q, dq/dt and the forces of its motors, with friction | `mechanical` | \
`trajectory`; `forward` where accelerations are known | any method that takes forces, and the \
effects `learned_friction` and `external_force` with the model: [machines](machines.md) |
| commands and momenta, where it is open which joints a command moves | `control_affine` | \
`vector_field` | the effect \
`external_force` with the model |

A model that was trained through a scheme (`steps`, `discrete_gradient`, `discrete_lagrangian`)
is right for that scheme and its h: it has learned the modified energy of the two together, its
card says so, and the simulator warns when it runs with others.

## What a training error means for a simulation

- *Energy.* A symplectic method keeps the learned H for as long as it runs, and a learned H that
  is off by at most e in the box of the data keeps the true energy within 2 e, and the small
  oscillation of the method, while the motion stays in the box. The error does not grow with time:
  a long run makes a good model no worse.
- *Path.* A field that is off makes the motion early or late, more so each turn: the path error
  grows in proportion to time, in a chaotic system exponentially, and no method can undo that.
- *Noise.* Noise on the states does not average out. A network that is asked for the rate at a
  noisy state learns the mean of the rates at the states that it may come from, which lie further
  inside: a slower system (a bias of errors in variables). The remedy is to smooth the log before
  training (`derivatives` in a training configuration does), to train through differences of
  states (`dgnet`), and few steps or a small `linearity`: a long descent fits the noise.
- *Losses.* A loss that is measured at noisy states has the noise in it, and says little of how
  well a model simulates: in the second table below the true H itself is beaten.

## The table of the original HNN

S. Greydanus, M. Dzamba, J. Yosinski, *Hamiltonian Neural Networks*, NeurIPS 2019: mass-spring
(H = q^2 + p^2) and pendulum (H = 3 (1 - cos q) + p^2), 25 orbits of 3 s with noise of 0.1 on each
state to learn from and 25 to test, and two bodies, 800 orbits of 20 s without noise to learn from
and 200 to test. Seed 0 is that of the published data, whose random numbers are drawn here in the
same order; the other seeds are other data of the same kind. Ours are of the family `hnn` with two
hidden layers of 64 (published: 200), Adam, then L-BFGS.

{hnn_published}

The test loss is as low as the data let it be. Each rate is that of the true state, while the
network is given the noisy one, so the loss of the true H is about the noise itself, and the best
possible function of a noisy state, E[rate | state], has a least loss that no training can be
expected to beat, on any but a lucky draw. Where the mean over seeds of our test loss is above the
published number, so is that least loss: the published number is of one draw.

{hnn_noise}

What these models are worth in a simulation, in the units of the system, is another matter:

{hnn_physics}

The energy error is that of the true H along the simulated orbits, 15 of them over 20 s (two
bodies: 25 s), the path error the distance from the true orbit over the same time.

## The table of DGNet

T. Matsubara, A. Ishikawa, T. Yaguchi, *Deep Energy-Based Modeling of Discrete-Time Physics*,
NeurIPS 2020: no rates are given. The same systems over 20 s at 100 instants (two bodies: 25 s at
500), learned from the differences of noisy states; published are means over 15 seeds. Ours are of
the family `dgnet`, trained by its discrete gradient and simulated by `discrete_gradient` at the
same h.

{dgnet_published}

{dgnet_physics}

On the real pendulum (M. Schmidt, H. Lipson, Science 324, 2009) the first four fifths of the log
are learned from, and the model swings on alone from the first state of the last fifth, with the
friction that it has learned. The published 4.92e-4 is of a DGNet that is solved by an adaptive
method; by its own discrete gradient it is 5.04e-4.

## The dissipative HNN on the real pendulum

A. Sosanya, S. Greydanus, *Dissipative Hamiltonian Neural Networks*, 2022, on the same log, with
rates from central differences. Ours are of the family `dissipative_hnn`, simulated by `gauss4`
with the effect `learned_dissipation`.

{dissipative_published}

The measure compares with the log, so the noise of the log stays in it. For scale: a parabola in
time, fitted to the energy of the test itself.

{real_physics}

## Machines

The family `mechanical`, each trained by `train --config NAME` as shipped
(`two_link_arm_characters`, `dfki_double_pendulum`, `multiarm_double_pendulum`,
`two_link_arm_chirps`; those of the free double pendulum with a rigid body in them by
`multiarm_rigid_body`); of several coordinates, one number each. *Networks* know nothing of the
machine but what turns; *rigid body and networks* adds `prior: double_pendulum`. *Others* is the
best that was published with the data, or a rigid body fitted to it. Of the baselines, the rigid
body is the prior alone with friction, and the plain network is of (q, v, tau), with the same
hidden layers, trained in the same way. A row is the mean of as many seeds as it says: where that
is one, luck of the seed is in it. What is not there was not measured. Every value:
[machines.json](learning/machines.json), of each model and seed
[machine_runs.json](learning/machine_runs.json).

{machines}

- *two-link arm that writes letters* (M. Lutter, J. Peters, 2021): how long a letter that was not
  learned is followed from its first sample, with its forces held over each sample of 0.04 s,
  until sum_i (error of q_i)^2 / var_i reaches 0.01. More is better.
- *real actuated double pendulum* (DFKI, hardware C.1): free simulation with the measured forces
  from a state every 50 ms; the *later* runs are swing-ups of another day.
- *real free double pendulum* (K. Kaheman et al., HardwareX 2023): from the first sample of each
  segment, as recorded; the mean of the errors of the four segments. In the last one the first
  velocities are off what the positions say, by 0.10 and 0.13 rad/s, which makes up most of what
  any model errs.
- *simulated arm with friction*: the arm of
  [two_joint_arm.urdf](../config/robots/two_joint_arm.urdf) with viscous and dry friction and a
  chirp for the torque of each motor, in six runs of 40 s to learn from and four others; messages
  at 250 Hz, with jitter, of which 2 % are lost, positions, velocities and torques quantised. How
  long a run is followed from its first sample, with its torques, until the error of a coordinate
  reaches 0.4 of its standard deviation; 40 s are all. More is better. Nobody else has measured it:
  20 s are what is asked for. One of the four runs swings further than any that was learned from
  (2.6 rad at the shoulder, for 2.0).

### Robots by their URDF

The family `rigid_body`, whose inertias, friction and offsets are identified, alone and with a
network beside it; [identify a robot](identify-robot.md) says how. The network is chosen by models
of the first three quarters of what is learned from, on the mean error of the last one, before any
test data is looked at; all are shown. Written by `python -m hnn_vi_ros.studies.robot_tables`
with `--data` and, for the UR10, `--ur10`, the URDF of `example-robot-data`; the values are in
[robots.json](learning/robots.json), of each model
[robot_runs.json](learning/robot_runs.json).

{robots}

- *real UR10*: 27.5 s of excitation; learned from the first 60 %, tested with the last 40 % less 60
  samples; `smoothing: 3`, `loss: inverse`, `friction: {{coulomb: 2}}`. Others: rigid body and
  friction by least squares.
- *real actuated double pendulum*: as above, from a URDF of two rods of 0.6 kg, `loss: trajectory`,
  `friction: {{coulomb: 2}}`.

## How the published measures are defined

As in the papers' public code, told here in our words:

- *test loss*: the mean over all test states and components of the squared difference between the
  field at the noisy state and the rate at the true one.
- *published energy MSE*: the mean over instants and orbits of the squared difference between the
  energies of the simulated and of the true orbit at the same instant. For mass-spring **and
  pendulum** the public code takes q^2 + p^2 for the energy. Of the pendulum that is not the
  energy: it changes along every orbit, and its difference mostly tells whether the model is early
  or late. The true H is in the tables beside it. For the two bodies it is H. The real pendulum's
  is 2.4 (1 - cos q) + v^2, whose 2.4 is a fit.
- Orbits for the energy of mass-spring and pendulum begin at q and p of 0.2 to 1 either way, 15 of
  them over 20 s at 100 instants. They are drawn after the data from the same generator, as the
  public code of DGNet does; which ones the table of the HNN used is not on record. We do not
  stretch the model's time by 1 + 0.9 noise, as copies of the original notebook do to undo the
  bias of the noise.
- The two bodies begin at the 15 states of seeds 0 to 14. Over how long the table of the HNN
  measured their energy we could not find out; ours is 25 s at 500 instants, as in the table of
  DGNet, longer than the 20 s of the training data.
- The friction of the published DGNet acts on H_p, ours on p.
- The spread is the standard deviation over seeds. *At or below* compares three digits, as
  published: of seed 0, and of the mean.

Widths, numbers of steps and weights are in
[published_tables.yaml](../config/studies/published_tables.yaml). They were chosen by hand with
seeds 0 to 9 and 101 to 105 in view, so these seeds are not untouched by the choice.
The log of the real pendulum is not ours to ship: `--data DIR` says where it is, and without it
those rows say *not measured*.
"""
