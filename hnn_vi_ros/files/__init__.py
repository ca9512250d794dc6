# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""
Read and write files: YAML, XML, standard streams, command lines, size limits.

All external files are read here, within limits and without executing their content. ``recording``
has the formats of bags, ``learning.data`` the formats of training logs.
"""

from typing import TYPE_CHECKING

from hnn_vi_ros.exports import lazy_exports

if TYPE_CHECKING:
    from hnn_vi_ros.files.command_line import complete_by, Parser, seconds
    from hnn_vi_ros.files.limits import (
        array_names, LONGEST_LINE, memory_for, parse_json, plain_number, safetensors_header,
        sha256_of, text_lines, unpack_arrays)
    from hnn_vi_ros.files.named_code import CODE_REFUSED, find_beside, import_named, NAMES_CODE
    from hnn_vi_ros.files.regular_file import (
        in_bytes, limited, no_file, numbered_paths, open_no_link, open_regular, read_limited,
        refuse_pointer)
    from hnn_vi_ros.files.resources import (
        cache_folder, can_be_written, expand_user, find_yaml, is_own, is_path, own_cache,
        package_file, prefixes, private_folder, private_key, SCHEME, share_folder, shipped_file,
        shipped_names, usual_folder, YAML_KINDS)
    from hnn_vi_ros.files.standard_streams import (
        elapsed, ENDING, harden_streams, lost_output, ProgressLine, rewrite_line, spare_output,
        write_problem)
    from hnn_vi_ros.files.writing import (
        check_new, make_folder, save_figure, write_bytes, write_new_scene, write_text, written)
    from hnn_vi_ros.files.xml_text import Element, MAX_XML_BYTES, parse_xml
    from hnn_vi_ros.files.yaml_file import (
        in_plain_words, json_schema, read_text, read_yaml, StrictModel, units_in, validate)
    from hnn_vi_ros.files.yaml_text import (
        dump_yaml, KeyPlaces, MAX_YAML_BYTES, one_line, parse_mapping, parse_yaml, root_node)

__getattr__, __dir__ = lazy_exports(__name__)
