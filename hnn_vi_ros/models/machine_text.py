# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""The parameters and the equation of a machine's model, as text for reports."""

from collections import defaultdict
from collections.abc import Iterator, Mapping

from hnn_vi_ros.models.mechanical_card import FrictionCard, MechanicalCard, PriorCard
from hnn_vi_ros.models.model_card import ModelCard
from hnn_vi_ros.models.planar_chain import chain_terms, CHAINS, sensor_offsets
import numpy as np

_UNEXPLAINED = (
    'These numbers are not a minimum that explains the log: residuals are more than five times '
    'the noise, so they have no intervals. Something is missing in the model, or the fit ended '
    'far from the best numbers.')
# Friction below this share of the largest one is not written.
_LEAST = 1e-4


def sum_text(combination: Mapping[str, float]) -> str:
    """Format a linear combination; the factor of the name '' is a constant."""
    text = ' '.join(f'{"-" if factor < 0.0 else "+"} ' + ' '.join(filter(None, (
        '' if abs(factor) == 1.0 and name else f'{abs(factor):.4g}', name)))
        for name, factor in combination.items() if factor)
    return text.removeprefix('+ ') or '0'


def equation_text(card: ModelCard) -> str:
    """
    Return the equation of motion of a model, '' if it is not of the family mechanical.

    M and V of rigid links are written out; those of networks, of a URDF and of exact systems are
    named.
    """
    mechanical, names = card.mechanical, [one.name for one in card.coordinates]
    if mechanical is None:
        return ''
    prior = mechanical.prior
    networks = '' if prior is not None and prior.alone else ' + networks'
    lines = ['H = p . M(q)^-1 p / 2 + V(q),  dq/dt = H_p,  dp/dt = -H_q + force']
    if prior is None:
        lines += ['M, V: networks']
    elif prior.kind in CHAINS:
        lines += (f'{line}{networks}' for line in _of_chain(mechanical, prior, names))
    else:
        lines += [f'M, V: those of {prior.kind}, with the parameters of this report{networks}']
    driven = card.domain is None or bool(card.domain.forces)
    return '\n'.join(('```text', *lines, *_forces(mechanical, names, driven), '```'))


def parameters_text(card: ModelCard, open_scale: str) -> str:
    """
    Return the parameters of a model as a table in Markdown, '' if it has none.

    Parameters
    ----------
    card : ModelCard
        Card of the model. A rigid body of a URDF has its own tables.
    open_scale : str
        Unit of the quantity that fixes the scale of all forces by convention, '' if the data do.

    """
    mechanical = card.mechanical
    if mechanical is None or mechanical.prior is None or mechanical.prior.tree is not None:
        return ''
    estimates, rows = mechanical.prior.estimates, list[tuple[str, float, str, str]]()
    first = list[str]()
    if estimates:
        rows = [(name, one.value, one.unit, '-' if one.interval is None else
                 f'{one.interval[0]:.6g} to {one.interval[1]:.6g}')
                for name, one in estimates.items()]
        said = ('The intervals hold if the noise of the sensors is the only error; where '
                'residuals exceed it, they are as many times wider, which may not suffice. '
                'Friction and springs without a row are not in the data; a width without a row '
                'cannot be told from them, and is taken as 2 % of the usual speed.')
        if all(one.interval is None for one in estimates.values()):
            first, said = [_UNEXPLAINED, ''], ''
        elif any(one.interval is None for one in estimates.values()):
            said = f'A number without an interval is not told by the data. {said}'
        pairs = {' and '.join(sorted([name, other]))
                 for name, one in estimates.items() for other in one.correlated}
        if pairs:
            said = (f'The data hardly tell apart {"; ".join(sorted(pairs))}: an error of one is '
                    f'made up for by the other. {said}')
    else:
        rows = [(name, one.value, one.unit, '-') for name, one in
                mechanical.prior.parameters.items()]
        said = ('Fits to positions estimate intervals, of rigid bodies alone. The equation has '
                'the friction.')
    return '\n'.join([
        *first, '| parameter | value | 95 % interval | unit |', '|---|---|---|---|', *(
            f'| {name} | {value:.6g} | {interval} | {ratio_unit(unit, open_scale)} |'
            for name, value, unit, interval in rows), '', said])


def ratio_unit(unit: str, open_scale: str) -> str:
    """Return the unit of a quantity over one that is 1 by convention, if it scales with forces."""
    if not open_scale or not unit.startswith(('N', 'kg', 'J')):
        return unit
    return '1' if unit == open_scale else f'{unit} / ({open_scale})'


def _of_chain(mechanical: MechanicalCard, prior: PriorCard, names: list[str]) -> Iterator[str]:
    terms, labels = chain_terms(mechanical.angles, prior.values), names
    names = [f'({sum_text({name: 1.0, "": -x})})' if x else name for name, x in zip(
        names, sensor_offsets(len(names), prior.values), strict=True)]

    def cosine(row: np.ndarray) -> str:
        angle = sum_text({name: x for name, x in zip(names, row.tolist(), strict=True) if x})
        return f'cos({angle})' if row.any() else ''
    for i, one in enumerate(labels):
        for j, other in enumerate(labels[:i + 1]):
            entry = {cosine(row): float(matrix[i, j]) for row, matrix in zip(
                terms.mass_rows, terms.matrices, strict=True) if matrix[i, j]}
            yield f'M[{one}, {other}] = {sum_text(entry)}'
    energy = {f'(1 - {cosine(row)})': float(weight) for row, weight in zip(
        terms.rows, terms.weights, strict=True) if row.any() and weight}
    energy |= {name: float(x) for name, x in zip(names, terms.pull, strict=True) if x}
    for i, j in np.argwhere(np.tril(terms.stiffness)):
        pair = f'{names[i]}^2 / 2' if i == j else f'{names[j]} {names[i]}'
        energy[pair] = float(terms.stiffness[i, j])
    for row, i in np.argwhere(terms.powers).tolist():
        energy[f'{names[i]}^{row + 3} / {row + 3}'] = float(terms.powers[row, i])
    energy |= {f'max({sum_text({names[0]: 1.0, "": -knot})}, 0)^2 / 2': bend for knot, bend in zip(
        terms.knots.tolist(), terms.bends.tolist(), strict=True) if bend}
    yield f'V = {sum_text(energy)}'


def _forces(mechanical: MechanicalCard, names: list[str], driven: bool) -> Iterator[str]:
    """Return the force on each coordinate: v is its velocity, u the command of a motor."""
    rows = np.eye(len(names)) if mechanical.input_map is None else np.array(mechanical.input_map)
    fade = mechanical.fade or rows.shape[1] * [0.0]
    motors = [f'u{k + 1}' + (f' / (1 + {g:.4g} abs(u{k + 1}))' if g else '')
              for k, g in enumerate(fade)]
    for i, name in enumerate(names):
        force = {motor: float(x) for motor, x in zip(motors, rows[i], strict=True) if driven and x}
        terms, back = force | _friction(mechanical.friction, i, False), ''
        if mechanical.friction.switch is not None:
            back = f' where v > 0, {sum_text(force | _friction(mechanical.friction, i, True))}' \
                ' where v < 0'
        network = '' if mechanical.friction_features is None else ' - (D(q) v of a network)'
        yield f'force on {name} = {sum_text(terms)}{back}{network}'


def _friction(friction: FrictionCard, i: int, back: bool) -> dict[str, float]:
    """Return the friction at a coordinate, at positive or at negative velocities."""
    def at(forward: list[float], backward: list[float] | None) -> float:
        return -(forward if backward is None or not back else backward)[i]
    # The members of a mean may have terms of the same width.
    found = defaultdict[str, float](float)
    found['v'] = at(friction.viscous, friction.viscous_back)
    for dry in friction.coulomb:
        found[f'tanh(v / {dry.width[i]:.4g})'] += at(dry.force, dry.back)
    for term in friction.stribeck:
        found[f'tanh(v / {term.width[i]:.4g}) exp(-(v / {term.speed[i]:.4g})^2)'] += \
            at(term.force, None)
    if friction.load is not None and friction.switch is not None:
        found[f'abs(motor force) tanh(v / {friction.switch[i]:.4g})'] = at(friction.load, None)
    if friction.offset is not None:
        found[''] = friction.offset[i]
    least = _LEAST * max(map(abs, found.values()))
    return {name: x for name, x in found.items() if abs(x) > least}
