# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""
Functions that are compiled only as parts of others, in a third of numba's compile time.

Numba optimises each function as if it were called separately, generates machine code for it, and
repeats that wherever it is inlined; but of a step with its solver and its gradient only the
outermost result is ever called. Functions compiled by LinkOnly are lowered and inlined into their
callers, whose own compilation optimises them once. If they create no array they count no
references, which for workspaces of a hundred arrays is half of the code: their outermost caller
owns all arrays.

Only this file uses numba's compiler passes, code libraries, cache and configuration.
"""

from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor, wait
from contextlib import contextmanager, ExitStack, nullcontext, suppress
from fcntl import flock, LOCK_EX, LOCK_NB
from functools import cache
import gc
from hashlib import sha256
import hmac
import os
from pathlib import Path
import pickle
import stat
from threading import current_thread, main_thread
import time
from typing import Any, BinaryIO
import warnings

from hnn_vi_ros.files import is_own, open_no_link, own_cache, private_key, written
from hnn_vi_ros.kernels.marks import register_by
from hnn_vi_ros.kernels.sources import digest_of
from llvmlite import ir
from llvmlite.binding import Linkage, parse_bitcode
import numba
from numba import _dynfunc
from numba.core import cgutils, config, types
from numba.core.base import BaseContext
from numba.core.caching import FunctionCache, IndexDataCacheFile
from numba.core.codegen import JITCodeLibrary
from numba.core.compiler import CompilerBase, DefaultPassBuilder
from numba.core.compiler_lock import global_compiler_lock, require_global_compiler_lock
from numba.core.compiler_machinery import PassManager, register_pass
from numba.core.ir import Return
from numba.core.lowering import Lower
from numba.core.registry import CPUDispatcher
from numba.core.runtime import rtsys
from numba.core.runtime.context import NRTContext
from numba.core.typed_passes import NativeLowering
from numba.extending import register_jitable


# Numba takes settings from this file of the working folder, whose author may be another user: for
# example where cached code is, and which Python modules find it.
if os.path.isfile(config._config_fname):
    warnings.warn(f'{config._config_fname} of the working folder is ignored; set environment '
                  'variables of numba instead', stacklevel=2)
config._config_fname = os.devnull
config.reload_config()


# Vectors of the full width. By LLVM's choice servers from Intel get half of it, because the first
# ones with 512 bits lowered their clock; those with this extension do not.
_FULL_WIDTH, _KEEPS_CLOCK = '"prefer-vector-width"="512"', '+avx512vbmi2'


class _Vectorised(JITCodeLibrary):
    """Code whose loops use vectors of 512 bits where a processor gains by it."""

    def add_ir_module(self, ir_module: ir.Module) -> None:
        """Add code."""
        if _KEEPS_CLOCK in self._codegen._tm_features.split(','):
            for function in ir_module.functions:
                # llvmlite has names of attributes alone.
                set.add(function.attributes, _FULL_WIDTH)
        super().add_ir_module(ir_module)


class _Library(_Vectorised):
    """Code to be linked into other libraries: inlined within itself, neither optimised nor run."""

    link_only = True
    # True if the code counts references to arrays.
    counts = False

    def creates_arrays(self) -> bool:
        """Return True if the code, or code that it calls, allocates what references are to."""
        # Linked functions contain their callees.
        return any(function.name.startswith('NRT_MemInfo_alloc')
                   for library in dict.fromkeys((self, *self._linking_libraries))
                   for function in library._final_module.functions)

    def finalize(self) -> None:
        """Link the called code, and inline it."""
        if not self.link_only:
            super().finalize()
            return
        require_global_compiler_lock()
        self._raise_if_finalized()
        for library in dict.fromkeys(self._linking_libraries):
            self._reload_init.update(library._reload_init)
            self._final_module.link_in(library._get_module_for_linking(), preserve=True)
        # The first of the two rounds of passes of numba's own libraries.
        passes, builder = self._codegen._module_pass_manager(
            loop_vectorize=self._codegen._loopvect, slp_vectorize=False,
            opt=self._codegen._opt_level, cost='cheap')
        passes.run(self._final_module, builder)
        self._finalize_dynamic_globals()
        self._finalized = True

    def defines(self, variable: str) -> bool:
        """Return True if the code itself defines a global variable."""
        try:
            self._final_module.get_global_variable(variable)
        except NameError:
            return False
        return True


class _Borrowed(NRTContext):
    """References that are not counted: the caller owns all arrays."""

    def incref(self, builder: ir.IRBuilder, typ: types.Type, value: ir.Value) -> None:
        """Count nothing."""

    def decref(self, builder: ir.IRBuilder, typ: types.Type, value: ir.Value) -> None:
        """Count nothing."""


def without_owners(context: BaseContext, builder: ir.IRBuilder, kind: types.Type,
                   value: ir.Value, place: tuple[int, ...] = ()) -> ir.Value:
    """Return a value with null owners in its part ``place``, of numba's type ``kind``."""
    if isinstance(kind, types.Array):
        model = context.data_model_manager[kind]
        for owner in ('meminfo', 'parent'):
            null = cgutils.get_null_value(context.get_value_type(model.get_type(owner)))
            value = builder.insert_value(value, null, (*place, model.get_field_position(owner)))
    elif isinstance(kind, types.BaseTuple):
        for k, part in enumerate(kind.types):
            value = without_owners(context, builder, part, value, (*place, k))
    elif context.data_model_manager[kind].contains_nrt_meminfo():
        # Other reference-counted objects keep their count, since the result is a new reference.
        NRTContext(context, True).incref(
            builder, kind, builder.extract_value(value, place) if place else value)
    return value


class _Lower(Lower):
    """Numba's lowering to LLVM, for a library that is only linked."""

    def __init__(self, *arguments: Any, **keywords: Any):
        super().__init__(*arguments, **keywords)
        if not self.library.counts:
            self.context.nrt = _Borrowed(self.context, True)

    def emit_environment_object(self) -> None:
        """Omit the environment, which is defined where it is used."""

    def lower_inst(self, inst: Any) -> None:
        """Lower an instruction; what is borrowed is returned without owners."""
        if isinstance(inst, Return) and not self.library.counts:
            name = inst.value.name
            self.storevar(without_owners(
                self.context, self.builder, self.typeof(name), self.loadvar(name)), name)
        super().lower_inst(inst)


@register_pass(mutates_CFG=True, analysis_only=False)
class _Lowering(NativeLowering):
    """Numba's lowering pass, into a library that is only linked."""

    _name = 'link_only_lowering'

    @property
    def lowering_class(self) -> type[Lower]:
        """Return the lowering class."""
        return _Lower

    def run_pass(self, state: Any) -> bool:
        """Lower a function, and register it for its callers."""
        context = state.targetctx
        # A copy: numba looks up compiled functions by the flags of their callers.
        state.flags = state.flags.copy()
        state.flags.no_compile = True
        for counts in (False, True):
            state.library = library = _Library(context.codegen(), state.func_id.func_qualname)
            library.counts = counts
            super().run_pass(state)
            if not library.creates_arrays():
                break
        function, environment = state['cr'].fndesc, state['cr'].env
        if library.defines(context.get_env_name(function)):
            # To print or raise, it creates Python objects from an environment that numba locates
            # by address: this function must be loaded.
            library.link_only = False
            library.enable_object_caching()
            entry = context.get_executable(library, function, environment)
        else:
            # Callers look a function up by this object, so each needs its own.
            entry = _dynfunc.make_function(
                function.lookup_module(), function.qualname.split('.')[-1], 'linked only', 0,
                environment, (library,))
        context.insert_user_function(entry, function, [library])
        state.reload_init.extend(library._reload_init)
        state['cr'] = state['cr']._replace(cfunc=entry)
        return True


class _WholeLibrary(_Vectorised):
    """Code that contains everything it calls, under names that are private to it."""

    def _optimize_final_module(self) -> None:
        # Numba numbers functions of one name and type in the order in which a process compiles
        # them. Code from the cache may contain the number of another function of this process;
        # both would then call the one that was loaded first.
        super()._optimize_final_module()
        for function in self._final_module.functions:
            if function.linkage == Linkage.linkonce_odr:
                function.linkage = 'internal'


@register_pass(mutates_CFG=True, analysis_only=False)
class _WholeLowering(NativeLowering):
    """Numba's lowering pass, into a library that shares nothing."""

    _name = 'whole_lowering'

    def run_pass(self, state: Any) -> bool:
        """Lower and load a function with everything it calls."""
        state.library = _WholeLibrary(state.targetctx.codegen(), state.func_id.func_qualname)
        state.library.enable_object_caching()
        return bool(super().run_pass(state))


def kept_module(library: JITCodeLibrary) -> Any:
    """Return a copy of the optimised code of a library, compiled now or loaded from disk."""
    return parse_bitcode(library._get_module_for_linking().as_bitcode())


class _Compiler(CompilerBase):
    """Numba's compiler with another lowering pass."""

    lowering: type[NativeLowering]

    def define_pipelines(self) -> list[PassManager]:
        """Return the passes."""
        whole = DefaultPassBuilder.define_nopython_pipeline(self.state)
        passes = PassManager(self.lowering._name)
        for kind, description in whole.passes:
            passes.add_pass(self.lowering if kind is NativeLowering else kind, description)
        passes.finalize()
        return [passes]


class LinkOnly(_Compiler):
    """Compiler of functions that are never called from Python."""

    lowering = _Lowering


class Whole(_Compiler):
    """Compiler of functions that are only called from Python."""

    lowering = _WholeLowering


class Part(CPUDispatcher):
    """
    A function that is compiled where compiled code calls it, once for all callers.

    Called from Python it is plain Python.

    Parameters
    ----------
    function : callable
        Function in numba's subset.
    targetoptions : dict
        Options of numba's compiler.
    others
        Arguments of numba, which rebuilds such an object from a cache on disk.

    """

    def __init__(self, py_func: Callable[..., Any],
                 locals: dict[str, Any] | None = None,  # noqa: A002
                 targetoptions: dict[str, Any] | None = None,
                 pipeline_class: type[CompilerBase] = LinkOnly):
        super().__init__(py_func, locals, {**_OPTIONS, **(targetoptions or {})}, pipeline_class)

    def __call__(self, *arguments: Any) -> Any:
        """Run as plain Python."""
        return self.py_func(*arguments)


def part(**options: Any) -> Callable[[Callable[..., Any]], Part]:
    """Return a decorator that converts a function to a Part, with these options of numba.njit."""
    return lambda function: Part(function, targetoptions=options)


_OPTIONS: dict[str, Any] = {'nopython': True, 'no_cpython_wrapper': True, 'no_cfunc_wrapper': True}
# Parts of functions that numba creates from a decorator such as register_jitable, one for each set
# of options of a caller.
LINK_ONLY: dict[str, Any] = {'pipeline_class': LinkOnly, **_OPTIONS}


def _register(function: Callable[..., Any], inline: bool) -> None:
    """Register a marked function for calls from compiled code."""
    register_jitable(**({'forceinline': True} if inline else {}), **LINK_ONLY)(function)


register_by(_register)


# A file begins with the version of numba that reads it, then the digest of the rest.
_MARK = b'hnn_vi_ros code, numba '
_HEAD = _MARK + numba.__version__.encode() + b'\n'
# Prefixes of other versions' files; before files had a digest, they were pickles.
_OTHERS = (b'hnn_vi_ros', pickle.PROTO)


class _Files(IndexDataCacheFile):
    """
    Numba's cache files of a function, each with a digest and the name of its index.

    Damaged files, and files of another function, count as absent: a changed bit in machine code
    ends a process, or changes a number. Files of other versions count as absent as well.

    Files are unpickled, which may run code. Files of the package are trusted like its sources,
    if they belong to its owner, to root or to this user, and nobody else can write to them. Others
    have a digest with a key that only this user can read.
    """

    # Files next to the source of the function, which another user may have compiled.
    beside: '_Files | None' = None
    # Owner of the package, for files next to it.
    owner: int | None = None

    def _digest(self, data: bytes) -> bytes:
        return hmac.digest(private_key() if self.owner is None else b'', data, 'sha256')

    def save(self, key: Any, data: Any) -> None:
        """Save the data of a key."""
        super().save(key, (key, data))

    def load(self, key: Any) -> Any:
        """Return the entry of a key, None if there is none."""
        own, data = super().load(key) or (key, None)
        if data is None and self.beside is not None:
            return self.beside.load(key)
        if own != key:
            self._warn('files belong to other functions')
            return None
        return data

    def _load_index(self) -> dict[Any, str]:
        stamp, overloads = self._read(self._index_path) or (None, {})
        return overloads if stamp == self._source_stamp else {}

    def _save_index(self, overloads: dict[Any, str]) -> None:
        self._write(self._index_path, (self._source_stamp, overloads))

    def _load_data(self, name: str) -> Any:
        return self._read(self._data_path(name))

    def _save_data(self, name: str, data: Any) -> None:
        self._write(self._data_path(name), data)

    def _write(self, path: str, content: Any) -> None:
        data = self._dump((self._index_name, content))
        with self._open_for_write(path) as file:
            file.write(_HEAD + self._digest(data) + data)

    @contextmanager
    def _open_for_write(self, filepath: str) -> Iterator[BinaryIO]:
        # Also with an umask of 0, nobody else can write to it. Its digest tells if data are lost.
        with written(Path(filepath), mode=0o644, synced=False) as file:
            yield file

    def _read(self, path: str) -> Any:
        """Return the content of a file of this function, None if it is unusable."""
        try:
            with open(path, 'rb', opener=open_no_link) as file:
                if self.owner is not None and not is_own(
                        os.fstat(file.fileno()), stat.S_IFREG, 0, self.owner):
                    self._warn('others can write to the files, or own them')
                    return None
                whole = file.read()
        except FileNotFoundError:
            return None
        except OSError as problem:
            self._warn(problem.strerror or str(problem))
            return None
        head, digest, data = _parts(whole, len(_HEAD), sha256().digest_size)
        if head != _HEAD and head.startswith(_OTHERS):
            return None
        if head != _HEAD or not hmac.compare_digest(self._digest(data), digest):
            self._warn('files are damaged, or were written by another user')
            return None
        try:
            name, content = pickle.loads(data)
        except Exception:
            # It was created from other sources, whose types no longer exist.
            return None
        if name != self._index_name:
            self._warn('files belong to other functions')
            return None
        return content

    def _warn(self, reason: str) -> None:
        _warn_once(f'cached compiled code in {self._cache_path} cannot be used', reason,
                   'it is compiled again')


def _parts(whole: bytes, *sizes: int) -> Iterator[bytes]:
    """Yield parts of bytes of these sizes, and the rest."""
    for size in sizes:
        yield whole[:size]
        whole = whole[size:]
    yield whole


_warned: set[str] = set()


def _warn_once(what: str, reason: str, then: str) -> None:
    """Warn about a consequence with its reason, once for all files."""
    if then not in _warned:
        _warned.add(then)
        warnings.warn(f'{what} ({reason}): {then}', stacklevel=2)


class _Cache(FunctionCache):
    """
    Numba's cache on disk, invalidated by a change of any source of a function.

    Without it, as on a full disk, compiled code also runs.
    """

    _cache_file: Any
    _cache_path: str

    def __init__(self, py_func: Callable[..., Any]):
        super().__init__(py_func)
        files, source = self._cache_file, Path(py_func.__code__.co_filename)
        described = files._index_name.removesuffix('.nbi'), files._source_stamp
        beside = source.parent / '__pycache__'
        # A package built and compiled by root is also read by users who cannot write there: its
        # cache is trusted like its sources. NUMBA_CACHE_DIR replaces both folders.
        kept = _Files(str(beside), *described)
        kept.owner = None if numba.config.CACHE_DIR else _owner(source, beside)
        if kept.owner is not None and beside == Path(self._cache_path):
            self._cache_file = kept
            return
        self._cache_path = _safe_folder(self._cache_path)
        self._cache_file = _Files(self._cache_path, *described)
        if kept.owner is not None:
            self._cache_file.beside = kept

    def _index_key(self, signature: Any, codegen: Any) -> tuple[Any, ...]:
        digest = digest_of(frozenset([self._py_func.__module__]))
        return (*super()._index_key(signature, codegen), digest)

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        """Load a compiled function without numba's compiler, whose set-up takes longer."""
        # Compiled code allocates memory by it.
        rtsys.initialize(target_context)
        with self._guard_against_spurious_io_errors():
            return self._load_overload(sig, target_context)

    def save_overload(self, sig: Any, data: Any) -> None:
        """Save a compiled function, or warn once that it cannot be saved."""
        try:
            super().save_overload(sig, data)
        except OSError as problem:
            _warn_of_lost(self._cache_path, problem.strerror or str(problem))


@cache
def _safe_folder(folder: str) -> str:
    """Return a folder of cached code, or another one if others can write to it."""
    if is_own(os.lstat(folder), stat.S_IFDIR):
        return folder
    other = own_cache(f'code/{sha256(folder.encode()).hexdigest()[:16]}')
    if numba.config.CACHE_DIR:
        _warn_once(f'compiled code cannot be cached in {numba.config.CACHE_DIR}',
                   'others can write to it', f'it is cached in {other.parent}')
    return str(other)


@cache
def _owner(source: Path, beside: Path) -> int | None:
    """Return the owner of a source file; None if others can write to the folder next to it."""
    owner = source.stat().st_uid
    with suppress(FileNotFoundError):
        if is_own(beside.lstat(), stat.S_IFDIR, 0, owner):
            return owner
    return None


def _warn_of_lost(folder: str, reason: str) -> None:
    _warn_once(f'compiled code cannot be cached in {folder}', reason,
               'the next start compiles again; free space, or set NUMBA_CACHE_DIR to another '
               'folder')


def set_identity(dispatcher: CPUDispatcher, identity: str) -> None:
    """
    Register a function under a stable name instead of a number that is new in each process.

    If another thread is just compiling a caller, numba has already numbered the function: the code
    of the caller is correct, but later processes do not find it on disk.
    """
    with suppress(AssertionError):
        dispatcher._set_uuid(identity)


# Maximum time to wait for a stopped process, and time between attempts [s].
_MAX_LOCK_SECONDS, _LOCK_INTERVAL = 300.0, 0.02


@contextmanager
def _locked(cache: Any) -> Iterator[None]:
    """Lock the cache files of a function, if the folder is writable."""
    path = Path(cache._cache_path, f'{cache._cache_file._index_name}.lock')
    with ExitStack() as stack:
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            file = stack.enter_context(open(path, 'w', opener=open_no_link))
        except OSError:
            yield
            return
        until = time.monotonic() + _MAX_LOCK_SECONDS
        while time.monotonic() < until:
            with suppress(BlockingIOError):
                flock(file, LOCK_EX | LOCK_NB)
                break
            time.sleep(_LOCK_INTERVAL)
        try:
            yield
        finally:
            # Waiting processes have this file open; later ones lock a new one, and find the code.
            path.unlink(missing_ok=True)


# Allocated objects before garbage is looked for while code is compiled.
_COLLECTED_AFTER = 200_000


@contextmanager
def _seldom_collected() -> Iterator[None]:
    """Look for garbage seldom: it takes an eighth of a compilation, which leaves hardly any."""
    with global_compiler_lock:
        first, *others = gc.get_threshold()
        gc.set_threshold(max(first, _COLLECTED_AFTER) if first else 0, *others)
        try:
            yield
        finally:
            gc.set_threshold(first, *others)


def aside(dispatcher: CPUDispatcher) -> CPUDispatcher:
    """
    Compile a function in a separate thread if the main thread requests it.

    Signals are handled only in the main thread, between Python instructions; after seconds of
    optimisation the first may be in a llvmlite callback, which swallows KeyboardInterrupt.
    """
    compile_ = dispatcher.compile

    def compile_once(signature: Any) -> Any:
        # One process at a time compiles; the others wait, and find the result on disk.
        kept = isinstance(dispatcher._cache, _Cache)
        with _locked(dispatcher._cache) if kept else nullcontext(), _seldom_collected():
            return compile_(signature)

    def compile_aside(signature: Any) -> Any:
        # Only the outermost compilation is locked, so that no two wait for each other.
        if global_compiler_lock.is_locked():
            return compile_(signature)
        if current_thread() is not main_thread():
            return compile_once(signature)
        pool = ThreadPoolExecutor(1)
        found = pool.submit(compile_once, signature)
        pool.shutdown(wait=False)
        # A signal that arrives just before a wait begins is handled after it.
        while not wait([found], 0.5).done:
            pass
        return found.result()
    dispatcher.compile = compile_aside
    return dispatcher


def keep(dispatcher: CPUDispatcher) -> CPUDispatcher:
    """Cache a function of this package on disk as long as its sources are unchanged."""
    try:
        dispatcher._cache = _Cache(dispatcher.py_func)
    except (RuntimeError, OSError):
        _warn_of_lost('the package or a cache folder', 'neither is writable')
    return aside(dispatcher)
