# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Schemas and channels of an MCAP file, and which of several definitions is believed."""

from collections.abc import Iterable

from hnn_vi_ros.bags.mcap_survey import Survey
from mcap.records import Channel, McapRecord, Schema


class Definitions:
    """
    Schemas and channels, by their numbers.

    Parameters
    ----------
    records : iterable of Schema or Channel
        Taken one by one.

    Attributes
    ----------
    schemas : dict of int to Schema
        Name and definition of each type.
    channels : dict of int to Channel
        Topic, encoding and metadata of each channel.
    contradicted : bool
        Whether one was taken that contradicts an earlier one.

    """

    def __init__(self, records: Iterable[Schema | Channel] = ()):
        self.schemas: dict[int, Schema] = {}
        self.channels: dict[int, Channel] = {}
        self.contradicted = False
        for record in records:
            self.take(record)

    def take(self, record: Schema | Channel) -> None:
        """Take one more; an earlier one of the number stays."""
        self.contradicted |= self.contradicts(record)
        self._of(record).setdefault(record.id, record)

    def contradicts(self, record: McapRecord) -> bool:
        """Return whether a record of its number is another one."""
        return self._of(record).get(record.id, record) != record

    def add(self, others: 'Definitions') -> None:
        """Add the definitions of others whose numbers are free."""
        self.schemas |= others.schemas | self.schemas
        self.channels |= others.channels | self.channels

    def _of(self, record: McapRecord) -> dict:
        return self.schemas if isinstance(record, Schema) else self.channels


def loose_definitions(survey: Survey) -> Definitions:
    """
    Return what is defined outside of chunks, where only the summary may have a checksum.

    Where that holds, the summary is believed; of two that contradict each other, none.
    """
    found: dict[tuple[type, int], Schema | Channel] = {}
    doubtful = set()
    for record in survey.definitions:
        if found.setdefault((type(record), record.id), record) != record:
            doubtful.add((type(record), record.id))
    for record in survey.repeated:
        key = type(record), record.id
        if survey.summary:
            found[key] = record
        elif found.setdefault(key, record) != record and survey.summary is None:
            doubtful.add(key)
    return Definitions(
        record for key, record in found.items() if key not in doubtful
        and not (isinstance(record, Channel) and (Schema, record.schema_id) in doubtful))
