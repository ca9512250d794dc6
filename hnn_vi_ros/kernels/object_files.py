# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Object files of compiled functions, for programs without Python."""

from collections.abc import Iterable
import platform
import re
from typing import Any

from hnn_vi_ros.errors import UnsupportedSystem
from hnn_vi_ros.kernels.linking import kept_module
import llvmlite.binding as llvm
from numba.core.registry import cpu_target

# Exceptions of Python, which nobody reads from C. They name files of this machine.
_EXCEPTION = re.compile(r'(?<!\n)@\.const\.picklebuf[\w.]*')
# Library and symbol of each function that is called by address.
_entries: dict[int, tuple[Any, str]] = {}


def entry_address(compiled: Any) -> int:
    """Return the address of a compiled function, given numba's result; see symbol_at."""
    name = compiled.fndesc.llvm_func_name
    address = int(compiled.library.get_pointer_to_function(name))
    _entries[address] = compiled.library, name
    return address


def symbol_at(address: int) -> str | None:
    """Return the symbol of a function that is called by address; None for other addresses."""
    return _entries[address][1] if address in _entries else None


def symbol_of(function: Any, *arguments: Any) -> str:
    """Return the symbol of a compiled function of arguments of these numba types."""
    function.compile(arguments)
    address = entry_address(function.overloads[arguments])
    return _entries[address][1]


def object_code(text: str, symbols: Iterable[str], machine: str = platform.machine()) -> bytes:
    """
    Return an object file of position-independent code for Linux.

    Functions are optimised as in this process, and so compute the same bits on its processor.

    Parameters
    ----------
    text : str
        LLVM's assembly of the functions that the file exports, which declares the others.
    symbols : iterable of str
        Symbols of the functions that it calls, and of those called by address.
    machine : str, optional
        Name of the 64-bit processors that run it, such as ``'aarch64'``. For others than this one,
        functions must be compiled for all processors of its kind.

    Raises
    ------
    UnsupportedSystem
        A function needs an address of this process.

    """
    codegen: Any = cpu_target.target_context.codegen()
    module = llvm.parse_assembly(text)
    exported = {function.name for function in module.functions if not function.is_declaration}
    triple, cpu, features = codegen.magic_tuple()
    module.triple, module.data_layout = triple, str(codegen.target_data)
    libraries = {name: own for own, name in _entries.values()}
    for library in dict.fromkeys(map(libraries.__getitem__, symbols)):
        module.link_in(llvm.parse_assembly(_EXCEPTION.sub('null', str(kept_module(library)))))
    for own in (*module.functions, *module.global_variables):
        if own.name.startswith('numba.dynamic.globals'):
            raise UnsupportedSystem('compiled code contains the address of an array of more than '
                                    '1 MB, and cannot be exported; pass it as a parameter')
        if not own.is_declaration and own.name not in exported:
            own.linkage = 'internal'
    if machine != platform.machine():
        llvm.initialize_all_targets()
        llvm.initialize_all_asmprinters()
        triple, cpu, features = f'{machine}-unknown-linux-gnu', '', ''
    target = llvm.Target.from_triple(triple).create_target_machine(
        cpu=cpu, features=features, opt=3, reloc='pic', codemodel='small')
    module.triple, module.data_layout = triple, str(target.target_data)
    passes = llvm.create_new_module_pass_manager()
    passes.add_global_dead_code_eliminate_pass()
    passes.run(module, llvm.create_pass_builder(target, llvm.create_pipeline_tuning_options()))
    # Numba's names differ from process to process.
    for k, own in enumerate((*module.functions, *module.global_variables)):
        if own.linkage == llvm.Linkage.internal:
            own.name = f'part_{k}'
        if own.is_function and not own.is_declaration:
            # None throws, so tables of frames for exceptions of C++ are left out.
            own.add_function_attribute('nounwind')
    module.verify()
    return bytes(target.emit_object(module))


def processor() -> str:
    """Return the name of the processor for which functions are compiled."""
    return str(cpu_target.target_context.codegen().magic_tuple()[1])
