# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Schemas made from constructors: types of every shape, and descriptions from the docstring."""

from typing import Literal

from hnn_vi_ros.scene.choices import choices, parameter_texts, summary
from hypothesis import given, strategies
from pydantic import TypeAdapter, ValidationError
import pytest


class Base:
    """
    What is common.

    Parameters
    ----------
    rate : float or list of float
        How fast [1/s], for all
        or for each.

    """


class Sample(Base):
    """
    A class as a scene may name one.

    Parameters
    ----------
    names, more : list of str
        Some ``names``.
    side : str
        One of two.

    Raises
    ------
    ValueError : never
        Not a parameter.

    """

    def __init__(self, names: list[str], rate: float | list[float],
                 side: Literal['above', 'below'] = 'above', more: list[str] | None = None,
                 count: int = 3, on: bool = True):  # noqa: D107
        self.names = names


SAMPLE = TypeAdapter(choices({'sample': Sample, 'base': Base}))
GOOD = {'kind': 'sample', 'names': ['x', 'y'], 'rate': 1}


def test_parameter_texts_are_those_of_the_class_and_its_bases_on_one_line():
    assert summary(Sample) == 'A class as a scene may name one.'
    assert parameter_texts(Sample) == {
        'rate': 'How fast [1/s], for all or for each.', 'names': 'Some names.',
        'more': 'Some names.', 'side': 'One of two.'}
    assert parameter_texts(int) == {}


def test_choices_take_their_fields_and_defaults_from_the_constructor():
    assert SAMPLE.validate_python(GOOD).model_dump() == {
        **GOOD, 'rate': 1.0, 'side': 'above', 'more': None, 'count': 3, 'on': True}
    assert SAMPLE.validate_python({'kind': 'base'}).model_dump() == {'kind': 'base'}
    assert TypeAdapter(choices({'base': Base})).validate_python({'kind': 'base'}).kind == 'base'


@pytest.mark.parametrize('field, value', [
    ('names', 'x'), ('names', [1]), ('names', None), ('rate', '1'), ('rate', True),
    ('rate', [1, None]), ('rate', float('nan')), ('rate', [float('inf')]), ('side', 'left'),
    ('more', 'x'), ('count', 3.0), ('count', True), ('on', 1), ('other', 1), ('kind', 'no')])
def test_choices_refuse_a_value_of_another_type(field: str, value: object):
    with pytest.raises(ValidationError):
        SAMPLE.validate_python({**GOOD, field: value})


def test_key_that_is_a_word_of_python_goes_by_its_own_name():
    class Named:
        """Something."""

        def __init__(self, from_: Literal['urdf'] | None = None):  # noqa: D107
            self.source = from_

    schema = TypeAdapter(choices({'named': Named}))
    assert schema.validate_python({'kind': 'named', 'from': 'urdf'}).model_dump() == {
        'kind': 'named', 'from': 'urdf'}
    with pytest.raises(ValidationError):
        schema.validate_python({'kind': 'named', 'from_': 'urdf'})


@given(rate=strategies.one_of(
    strategies.integers(-2**53, 2**53), strategies.floats(allow_nan=False, allow_infinity=False),
    strategies.lists(strategies.integers(-2**53, 2**53), max_size=4)))
def test_choices_take_whole_numbers_for_floats(rate: float | list[float]):
    assert SAMPLE.validate_python({**GOOD, 'rate': rate}).rate == rate
