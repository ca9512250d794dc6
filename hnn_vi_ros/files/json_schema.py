# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""The JSON schemas by which editors complete and check YAML files."""

import json

from pydantic import BaseModel
from pydantic.json_schema import GenerateJsonSchema


def json_schema(model: type[BaseModel], title: str) -> str:
    """
    Return the schema of a file, JSON Schema draft 2020-12.

    Parameters
    ----------
    model : type of BaseModel
        Schema of the file.
    title : str
        Description of the file.

    """
    schema = model.model_json_schema(schema_generator=_Plain)
    schema = {'$schema': _Plain.schema_dialect, **schema, 'title': title}
    return json.dumps(schema, indent=2, ensure_ascii=False)


class _Plain(GenerateJsonSchema):
    """A JSON schema without a title for each key, which would only repeat its name."""

    def field_title_should_be_set(self, schema: object) -> bool:
        return False
