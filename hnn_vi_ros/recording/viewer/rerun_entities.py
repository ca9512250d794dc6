# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Entities of a rerun recording: the robot, arrows of forces, and phase portraits."""

from collections.abc import Iterator, Mapping, Sequence
import math
from tempfile import NamedTemporaryFile
from typing import Any, final

from hnn_vi_ros.effects import Effect, EFFECTS, EffectState, Force, Potential
from hnn_vi_ros.errors import RecordingError
from hnn_vi_ros.files import one_line
from hnn_vi_ros.hamiltonians import (
    AMBER, Ball, Cuboid, Hamiltonian, Joint, joint_pose, Mechanism, Part, Robot, shapes_of, SILVER,
    SLIDING, tip_of, Trail)
from hnn_vi_ros.phase_space import rotor_name
from hnn_vi_ros.recording.sample import Sample
from hnn_vi_ros.recording.viewer import rerun_blueprint as layout
from hnn_vi_ros.recording.viewer.phase_portrait import Bounds, fit_frame, frame_of
from hnn_vi_ros.recording.viewer.rerun_blueprint import PALETTE
import numpy as np
import rerun as rr
from rerun.urdf import UrdfTree

# Entity with the frame of the robot's root, and entities that move its joints.
_WORLD, _JOINTS, _ROOT = '/world', '/joints', '/joints/root'
# Entities below the world, which are visible in the view of the mechanism.
_EFFORTS, _SKELETON = '/world/efforts', '/world/skeleton'
# Length of an arrow at the effort limit relative to the reach; its colours (red, green, blue) at
# zero effort and at the limit.
_EFFORT_ARROW = 0.4
_IDLE_COLOR, _LIMIT_COLOR = np.array([60.0, 200.0, 255.0]), np.array([235.0, 20.0, 60.0])
_GRAVITY = 9.81


@final
class RobotPicture:
    """
    A robot in a recording.

    Parameters
    ----------
    robot : Robot
        Robot from a file, which also provides its shapes and meshes.
    coordinates : sequence of str
        Names of the moving joints in the order of q; the others are fixed.
    recording : rerun.RecordingStream
        Recording that receives the data.

    Attributes
    ----------
    problem : str
        Reason for also drawing the skeleton; '' if all shapes are available.

    Raises
    ------
    RecordingError
        The SDK cannot read the file.

    """

    def __init__(self, robot: Robot, coordinates: Sequence[str], recording: rr.RecordingStream):
        self._recording = recording
        text, self.problem = shapes_of(robot)
        try:
            with NamedTemporaryFile('w', suffix='.urdf', encoding='utf-8') as file:
                file.write(text)
                file.flush()
                tree = UrdfTree.from_file_path(file.name, entity_path_prefix=_WORLD[1:])
            tree.log_urdf_to_recording(recording)
        except (OSError, RuntimeError, ValueError) as problem:
            raise RecordingError(f'{robot.where}: rerun cannot show this robot: '
                                 f'{one_line(problem)}') from problem
        recording.log(_ROOT, rr.Transform3D(
            translation=[0.0, 0.0, 0.0], parent_frame=f'tf#{_WORLD}',
            child_frame=tree.root_link().name), static=True)
        own = robot.joints
        names = [name for name in dict.fromkeys([*coordinates, *robot.followers, *robot.locked])
                 if name in own]
        # Path of each joint, and its value: a row of factors of q, and a constant.
        self._joints = [
            (own[name], f'{_JOINTS}/{rr.escape_entity_path_part(name)}', *values)
            for name, *values in zip(names, *robot.driven(names, coordinates), strict=True)]
        # Joints that move, and the columns of their motors, which may be rotors.
        columns = {name: i for i, name in enumerate(coordinates)}
        rotors = {name: i for name, i in columns.items() if name not in own}
        self._moving = [(own[name], rotors.get(rotor_name(name), i))
                        for name, i in columns.items() if name in own]
        self._reach, self._usual = _reach_of(robot), _usual_effort(robot)
        if self.problem:
            self._draw_skeleton(robot)

    def _draw_skeleton(self, robot: Robot) -> None:
        """Draw a bone from the origin of each link to its joints, or to its end."""
        for name, link in robot.links.items():
            tip = tip_of(link)
            ends = [joint.origin for joint in link.joints] + ([] if tip is None else [tip])
            path = f'{_SKELETON}/{rr.escape_entity_path_part(name)}'
            self._recording.log(path, rr.CoordinateFrame(name), static=True)
            self._recording.log(path, rr.LineStrips3D(
                [[np.zeros(3), end] for end in ends], radii=0.012 * self._reach, colors=SILVER),
                static=True)

    def send(self, times: list[rr.TimeColumn], q: np.ndarray, efforts: np.ndarray | None = None
             ) -> None:
        """
        Move the joints to q at n times.

        Parameters
        ----------
        times : list of rerun.TimeColumn
            Times of n samples.
        q : np.ndarray, shape (n, d)
            Coordinates [rad], [m].
        efforts : np.ndarray, shape (n, d), optional
            Efforts of motors [N m], [N]. An arrow along each joint's axis (right-hand rule) is
            longer and redder the nearer the effort is to the joint's limit. Without a limit, the
            reference is the moment of the robot's weight at its reach, or the weight.

        """
        for joint, path, factors, constant in self._joints:
            values = q @ factors + constant
            # Computed here, because the SDK does not normalise axes.
            places, turns = joint_pose(joint, values)
            self._recording.send_columns(path, times, rr.Transform3D.columns(
                translation=places, quaternion=turns.as_quat(),
                parent_frame=[joint.parent] * len(values),
                child_frame=[joint.child] * len(values)), strict=True)
        if efforts is not None:
            for joint, column in self._moving:
                self._send_effort(times, joint, efforts[:, column])

    def _send_effort(self, times: list[rr.TimeColumn], joint: Joint, effort: np.ndarray) -> None:
        path = f'{_EFFORTS}/{rr.escape_entity_path_part(joint.name)}'
        # In the frame of the moved link, in which the joint's axis is constant.
        self._recording.log(path, rr.CoordinateFrame(joint.child), static=True)
        usual = self._usual / (self._reach if joint.kind == SLIDING else 1.0)
        share = np.clip(effort / (joint.limits.effort or usual), -1.0, 1.0)
        vectors = (_EFFORT_ARROW * self._reach * share)[:, None] * joint.axis
        colors = _IDLE_COLOR + np.abs(share)[:, None] * (_LIMIT_COLOR - _IDLE_COLOR)
        self._recording.send_columns(path, times, rr.Arrows3D.columns(
            vectors=vectors, colors=colors.astype(np.uint8),
            radii=np.full(len(share), 0.012 * self._reach)), strict=True)


def collisions_of(robot: Robot) -> str:
    """Return the entity of the SDK's collision shapes, which hide the visual ones."""
    return f'{_WORLD}/{rr.escape_entity_path_part(robot.name)}/collision_geometries'


def bounds_of_robot(robot: Robot) -> np.ndarray:
    """
    Return two corners of the space that a view of a robot must show, shape (2, 3) [m].

    It is the cube inscribed in the sphere that contains the robot in any configuration: a camera
    that sees all corners of the cube sees the sphere.
    """
    half = _reach_of(robot) / np.sqrt(3.0)
    return np.array([[-half] * 3, [half] * 3])


def bounds_of_path(places: Mapping[str, np.ndarray]) -> np.ndarray:
    """
    Return two corners of the space that a robot fills on a path, shape (2, 3) [m].

    ``places`` are its bones: the origins of the links and the approximate ends of those without
    joints, which are twice as far away as the centre of mass. A margin of a twentieth of the
    largest edge on each side allows for the thickness of the links.
    """
    points = [*places.values()] or [np.zeros((1, 2, 3))]
    corners = np.array([np.min(points, axis=(0, 1, 2)), np.max(points, axis=(0, 1, 2))])
    margin = 0.05 * (np.ptp(corners, axis=0).max() or 1.0)
    return corners + margin * np.array([[-1.0], [1.0]])


def trails_of(robot: Robot, places: Mapping[str, np.ndarray]) -> dict[str, Part]:
    """Return the trails of the ends of links without joints, from the bones of a path."""
    radius = 0.006 * float(np.ptp([*places.values()], axis=(0, 1, 2)).max()) if places else 0.0
    return {f'path of {name}': Trail(places[end][:, 1], radius, AMBER)
            for name, link in robot.links.items()
            if not link.joints and (end := f'end of {name}') in places}


def _reach_of(robot: Robot) -> float:
    """Return the radius of a sphere about the root that always contains the robot [m]."""
    reach, waiting = 0.0, [(robot.root, 0.0)]
    while waiting:
        name, distance = waiting.pop()
        link = robot.links[name]
        tip = 0.0 if link.inertial is None else float(np.linalg.norm(link.inertial.centre))
        reach = max(reach, distance + 2.0 * tip)
        for joint in link.joints:
            slide = max(map(abs, filter(None, joint.bounds)), default=0.0)
            waiting.append((joint.child, distance + float(np.linalg.norm(joint.origin))
                            + slide * (joint.kind == SLIDING)))
    return reach if reach > 0.0 else np.sqrt(3.0)


def _usual_effort(robot: Robot) -> float:
    """Return the moment of the total weight at the reach [N m]."""
    mass = sum(link.inertial.mass for link in robot.links.values() if link.inertial is not None)
    return _GRAVITY * max(mass, 1e-3) * _reach_of(robot)


# Name of the forces due to commands.
MOTORS = 'motors'
# Length of the largest arrow among the first samples, at most, and radius of an arrow, relative to
# half of the mechanism's extent.
_FORCE_ARROW, _FORCE_ARROW_RADIUS = 1.0, 0.03
# Step of finite differences, relative to the range of q, for derivatives of positions.
_DIFFERENCE_STEP = 1e-6
# Colours of the palette from the third on: mechanisms use the first two.
_COLORS = ('green', 'pink', 'turquoise', 'red', 'violet', 'yellow')


@final
class ForceArrows:
    """
    The generalised force of each effect, as forces on the bodies that a mechanism draws.

    Many forces F on the bodies produce the generalised force f: J^T F = f with the Jacobian J of
    their positions. The minimum-norm solution is drawn: in Cartesian coordinates the force itself;
    for a pendulum, the torque over the drawn length of its rod, across the rod.

    Parameters
    ----------
    effects : sequence of Effect
        All effects of the scene; those that are not ``drawn`` are ignored.
    hamiltonian : Hamiltonian
        H, whose coordinates the effects name.
    mechanism : callable
        The mechanism to draw; see :mod:`hnn_vi_ros.hamiltonians.mechanisms`.
    step_size : float
        Step size h [s]; effects count time from step 0.
    reach, size : float
        Reach of the mechanism, and half of its extent [m].

    Attributes
    ----------
    scale : float
        Arrow length of a force of 1 N [m]; NaN before the first force.

    """

    def __init__(self, effects: Sequence[Effect], hamiltonian: Hamiltonian, mechanism: Mechanism,
                 step_size: float, reach: float, size: float):
        self._mechanism, self._step_size = mechanism, step_size
        self._reach, self._size = reach, size
        d = hamiltonian.dimension
        state = EffectState.empty(len(effects), d)
        kinds = {effect: kind for kind, effect in EFFECTS.items() if effect.drawn}
        known = [effect for effect in effects if type(effect) in kinds]
        # All effects are resolved before any acts: friction needs to know the magnetic fields.
        resolved = [effect.resolve(hamiltonian.coordinates, state) for effect in known]
        self._effects: list[tuple[str, Effect, Any]] = []
        for effect, own in zip(known, resolved, strict=True):
            kind = kinds[type(effect)]
            count = sum(type(other) is type(effect) for other in known)
            index = sum(name.startswith(kind) for name, _, _ in self._effects)
            self._effects.append((f'{kind}.{index}' if count > 1 else kind, effect, own))
        self._curl = state.gauge.T - state.gauge
        self.scale = math.nan

    def columns(self, samples: Sequence[Sample]) -> Iterator[tuple[str, rr.ComponentColumnList]]:
        """Yield each force's name and its arrows at n samples, starting at the bodies."""
        q = np.array([sample.q for sample in samples])
        forces = {name: np.array([self._force(effect, own, sample) for sample in samples])
                  for name, effect, own in self._effects}
        if any(sample.motors is not None for sample in samples):
            forces[MOTORS] = np.array([np.zeros(q.shape[1]) if sample.motors is None
                                       else sample.motors for sample in samples])
        if not forces:
            return
        places, jacobian = self._bodies(q)
        inverse = np.linalg.pinv(np.nan_to_num(jacobian)).swapaxes(1, 2)
        arrows = {name: (inverse @ force[..., None]).reshape(places.shape)
                  for name, force in forces.items()}
        if math.isnan(self.scale):
            self.scale = self._scale_of(np.array([*arrows.values()]))
        if not math.isnan(self.scale):
            for name, vectors in arrows.items():
                yield name, _arrows(places, self.scale * vectors)

    def style(self, name: str) -> rr.Arrows3D:
        """Return the style of a force's arrows, without labels, which would hide them."""
        return rr.Arrows3D.from_fields(
            colors=[PALETTE[2 + self._color(name)]], radii=[_FORCE_ARROW_RADIUS * self._size])

    def legend(self, names: Sequence[str]) -> str:
        """Return a legend of the arrows for the user."""
        colors = ', '.join(f'{name} {_COLORS[self._color(name)]}' for name in names)
        return f'force arrows, 1 N is {self.scale:g} m long: {colors}'

    def _color(self, name: str) -> int:
        names = [*(other for other, _, _ in self._effects), MOTORS]
        return names.index(name) % len(_COLORS)

    def _force(self, effect: Effect, own: Any, sample: Sample) -> np.ndarray:
        """Return the generalised force of an effect at a sample, shape (d,)."""
        if isinstance(effect, EFFECTS['magnetic_field']):
            return self._curl @ sample.dH_dp
        f_q, f_p = np.zeros((2, sample.q.size))
        if isinstance(effect, Potential):
            effect.add_gradient(own, sample.q, f_p)
            return -f_p
        assert isinstance(effect, Force), 'other effects are not drawn'
        effect.add_force(own, sample.step * self._step_size, sample.q, sample.p, sample.dH_dp,
                         f_q, f_p)
        return f_p

    def _bodies(self, q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return positions of m bodies, shape (n, m, 3), and their derivatives, (n, 3 m, d)."""
        step = _DIFFERENCE_STEP * max(self._reach, 1.0)
        columns = [(self._places(q + shift) - self._places(q - shift)) / (2.0 * step)
                   for shift in step * np.eye(q.shape[1])]
        jacobian = np.stack([column.reshape(len(q), -1) for column in columns], axis=-1)
        return self._places(q), jacobian

    def _places(self, q: np.ndarray) -> np.ndarray:
        parts = self._mechanism(q, self._reach).values()
        return np.stack([part.center for part in parts
                         if isinstance(part, Ball | Cuboid) and part.moves], axis=1)

    def _scale_of(self, arrows: np.ndarray) -> float:
        """Return a length for 1 N that shows the largest force: 1, 2 or 5 times a power of ten."""
        largest = float(np.linalg.norm(arrows, axis=-1).max(initial=0.0, where=np.isfinite(
            arrows).all(axis=-1)))
        if largest == 0.0:
            return math.nan
        longest = _FORCE_ARROW * self._size / largest
        power = 10.0 ** math.floor(math.log10(longest))
        return max(factor * power for factor in (1.0, 2.0, 5.0) if factor * power <= longest)


def _arrows(places: np.ndarray, vectors: np.ndarray) -> rr.ComponentColumnList:
    """Return rows of arrows, one arrow per body, one row per sample."""
    n, bodies, _ = places.shape
    return rr.Arrows3D.columns(origins=places.reshape(-1, 3), vectors=vectors.reshape(-1, 3)
                               ).partition([bodies] * n)


@final
class Portraits:
    """
    The phase portraits of the first coordinates.

    Parameters
    ----------
    recording : rerun.RecordingStream
        Recording that receives the data.
    hamiltonian : Hamiltonian
        H.
    q0, p0 : np.ndarray, shape (d,)
        Initial state.
    box : tuple of np.ndarray, shape (d, 2) each
        Minimum and maximum of q and p of the training data, or of a path.
    count : int
        Number of portraits.
    side : float
        Width of a frame in points.

    """

    def __init__(self, recording: rr.RecordingStream, hamiltonian: Hamiltonian, q0: np.ndarray,
                 p0: np.ndarray, box: Bounds, count: int, side: float):
        self._recording, self._hamiltonian = recording, hamiltonian
        self._start, self._side = (q0, p0), side
        self._frames = [frame_of(axis, q0, p0, box) for axis in range(count)]
        # Newest (q, p) of each, and minimum and maximum: shapes (count, 2), (count, 2, 2).
        self._last: np.ndarray | None = None
        self._path = np.tile([np.inf, -np.inf], (count, 2, 1))
        self._draw()

    def send(self, times: list[rr.TimeColumn], q: np.ndarray, p: np.ndarray) -> None:
        """
        Extend each path with the segments to n new points.

        Parameters
        ----------
        times : list of rerun.TimeColumn
            Times of n samples.
        q, p : np.ndarray, shape (n, d)
            States at these times.

        """
        count = len(self._frames)
        if not count:
            return
        new = np.stack([q[:, :count], p[:, :count]], axis=-1)
        points = np.concatenate([new[:1] if self._last is None else self._last[None], new])
        self._last = points[-1]
        self._note(new)
        for frame in self._frames:
            path = layout.phase_path(self._hamiltonian.coordinates[frame.axis])
            own = points[:, frame.axis]
            for child, columns in (
                    ('trail', rr.LineStrips2D.columns(strips=np.stack([own[:-1], own[1:]], 1))),
                    ('state', rr.Points2D.columns(positions=own[1:]))):
                self._recording.send_columns(f'{path}/{child}', times, columns, strict=True)

    def _note(self, points: np.ndarray) -> None:
        """Extend the known range of (q, p) by points, shape (n, count, 2)."""
        low, high = (np.where(np.isfinite(points), points, end) for end in (np.inf, -np.inf))
        self._path[..., 0] = np.minimum(self._path[..., 0], low.min(axis=0, initial=np.inf))
        self._path[..., 1] = np.maximum(self._path[..., 1], high.max(axis=0, initial=-np.inf))

    def fit(self) -> None:
        """Redraw the static parts in frames that contain the paths."""
        self._frames = [
            fit_frame(frame, self._path[frame.axis])
            if np.isfinite(self._path[frame.axis]).all() else frame for frame in self._frames]
        self._draw()

    def _draw(self) -> None:
        for frame in self._frames:
            layout.log_phase_portrait(
                self._recording, self._hamiltonian, frame, *self._start, self._side)
