# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Private names of other packages: one file uses those of each package."""

import ast
import inspect

from numba.core.caching import FunctionCache
from numba.core.codegen import JITCodeLibrary
from numba.core.lowering import Lower
from numba.core.registry import CPUDispatcher
from numba.core.typed_passes import NativeLowering
from sources import MODULES, PACKAGE, tree

# By file: whose it is, and what; the file says why. What is documented in spite of its name, such
# as _replace of a named tuple, is no such thing.
PRIVATE = {
    'recording/bags/mcap_sink.py': ('mcap', {'_Writer__chunk_indices'}),
    'files/command_line.py': ('argparse', {'_actions'}),
    'kernels/linking.py': ('numba', {
        '_cache', '_codegen', '_config_fname', '_data_path', '_final_module',
        '_finalize_dynamic_globals', '_get_module_for_linking',
        '_guard_against_spurious_io_errors', '_index_name', '_index_path', '_linking_libraries',
        '_load_overload', '_loopvect', '_module_pass_manager', '_opt_level', '_py_func',
        '_raise_if_finalized', '_reload_init', '_set_uuid',
        '_source_stamp', '_tm_features', 'numba._dynfunc'}),
    'learning/graph_of_module.py': ('torch', {
        '_adaptive_avg_pool2d', '_native_batch_norm_legit',
        '_native_batch_norm_legit_no_training', '_overloadpacket', '_pytree',
        'torch._decomp.core_aten_decompositions', 'torch._decomp.get_decompositions',
        'torch.utils._python_dispatch.TorchDispatchMode'}),
    'ros/plumbing/rclpy_internals.py': ('rclpy', {
        '_service_callback', '_service_change_state', '_state_machine',
        'rclpy.impl.implementation_singleton.rclpy_implementation',
        'rclpy.impl.rcutils_logger.RcutilsLogger'}),
    'recording/viewer/rerun_stream.py': (
        'rerun', {'_from_native', '_log_to_stream', 'rerun.bindings'}),
}
# Functions of numba that others take the place of, and their parameters.
REPLACED = {
    JITCodeLibrary.finalize: 'self', JITCodeLibrary._raise_if_finalized: 'self',
    JITCodeLibrary._optimize_final_module: 'self',
    JITCodeLibrary._finalize_dynamic_globals: 'self',
    JITCodeLibrary._get_module_for_linking: 'self', NativeLowering.run_pass: 'self, state',
    Lower.emit_environment_object: 'self', FunctionCache._index_key: 'self, sig, codegen',
    CPUDispatcher._set_uuid: 'self, u'}
DOCUMENTED = {'_asdict', '_exit', '_fields', '_make', '_replace'}
# Parts of packages that are theirs alone although their names do not say so.
INTERNAL = {'rclpy.impl', 'rerun.bindings'}


def is_private(name: str) -> bool:
    return name.startswith('_') and not name.endswith('__')


def defined_and_used(module: ast.Module) -> tuple[set[str], set[str]]:
    """
    Return the names that a file defines, and the private ones that it uses or imports.

    Defined are functions, classes, the attributes of these and those of self.
    """
    defined, used = set[str](), set[str]()
    for node in ast.walk(module):
        match node:
            case ast.Attribute(value=ast.Name(id='self' | 'cls'), attr=name, ctx=ast.Store()):
                defined.add(name)
            case ast.FunctionDef(name=name) | ast.AsyncFunctionDef(name=name):
                defined.add(name)
            case ast.ClassDef(name=name, body=body):
                defined.add(name)
                for line in body:
                    targets = line.targets if isinstance(line, ast.Assign) else \
                        [line.target] if isinstance(line, ast.AnnAssign) else []
                    defined |= {one.id for one in targets if isinstance(one, ast.Name)}
            case ast.Import(names=names):
                used |= {alias.name for alias in names}
            case ast.ImportFrom(module=package, names=names):
                used |= {f'{package}.{alias.name}' for alias in names}
        if isinstance(node, ast.Attribute) and is_private(node.attr):
            used.add(node.attr)
    return defined, {name for name in used if not name.startswith('hnn_vi_ros') and (
        any(map(is_private, name.split('.'))) or name.startswith(tuple(INTERNAL)))}


def test_what_others_keep_to_themselves_is_used_in_one_file_for_each():
    found = {path.relative_to(PACKAGE).as_posix(): defined_and_used(tree(path))
             for path in MODULES}
    own = set.union(*(defined for defined, _ in found.values())) | DOCUMENTED
    assert {name: used - own for name, (_, used) in found.items() if used - own} == {
        name: names for name, (_, names) in PRIVATE.items()}
    owners = [owner for owner, _ in PRIVATE.values()]
    assert len(set(owners)) == len(owners)


def test_numba_has_the_functions_that_ours_replace():
    assert {function: ', '.join(inspect.signature(function).parameters)
            for function in REPLACED} == REPLACED
