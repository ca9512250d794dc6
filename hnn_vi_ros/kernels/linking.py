# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""
Functions that are compiled only as parts of others, at a third of what numba takes for them.

Numba optimises each function as if it were to be called by itself, writes machine code for it,
and does all that again wherever it is inlined: of a step with its solver and its gradient only
the outermost result is ever called. Functions that are compiled by LinkOnly are translated and
inlined into their callers, whose own compilation optimises them, once.

This is the one file that uses numba's compiler passes, code libraries and cache.
"""

from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor, wait
from contextlib import contextmanager, ExitStack, nullcontext, suppress
from fcntl import flock, LOCK_EX, LOCK_NB
from hashlib import sha256
from pathlib import Path
import pickle
from threading import current_thread, main_thread
import time
from typing import Any
import warnings

from hnn_vi_ros.kernels.marks import register_by
from hnn_vi_ros.kernels.sources import digest_of
from llvmlite.binding import Linkage
import numba
from numba import _dynfunc
from numba.core.caching import FunctionCache, IndexDataCacheFile
from numba.core.codegen import JITCodeLibrary
from numba.core.compiler import CompilerBase, DefaultPassBuilder
from numba.core.compiler_lock import global_compiler_lock, require_global_compiler_lock
from numba.core.compiler_machinery import PassManager, register_pass
from numba.core.lowering import Lower
from numba.core.registry import CPUDispatcher
from numba.core.typed_passes import NativeLowering
from numba.extending import register_jitable


class _Library(JITCodeLibrary):
    """Code to be linked into other libraries: inlined within itself, neither optimised nor run."""

    link_only = True

    def finalize(self) -> None:
        """Link what this code calls, and inline it."""
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
        """Return whether the code itself holds a global variable."""
        try:
            self._final_module.get_global_variable(variable)
        except NameError:
            return False
        return True


class _Lower(Lower):
    """Numba's translation into LLVM's language, whose environment is defined where it is used."""

    def emit_environment_object(self) -> None:
        """Leave the environment out until something asks for it."""


@register_pass(mutates_CFG=True, analysis_only=False)
class _Lowering(NativeLowering):
    """Numba's last pass, into a library that is only linked."""

    _name = 'link_only_lowering'

    @property
    def lowering_class(self) -> type[Lower]:
        """Return what translates a function."""
        return _Lower

    def run_pass(self, state: Any) -> bool:
        """Translate a function, and register it for those that call it."""
        context = state.targetctx
        state.library = library = _Library(context.codegen(), state.func_id.func_qualname)
        # A copy: numba finds compiled functions by the flags of their callers.
        state.flags = state.flags.copy()
        state.flags.no_compile = True
        super().run_pass(state)
        function, environment = state['cr'].fndesc, state['cr'].env
        if library.defines(context.get_env_name(function)):
            # Python makes anything it prints or raises, from an environment that numba finds by
            # its address: this one has to be loaded.
            library.link_only = False
            library.enable_object_caching()
            entry = context.get_executable(library, function, environment)
        else:
            # Callers find a function by this object, so that each needs one of its own.
            entry = _dynfunc.make_function(
                function.lookup_module(), function.qualname.split('.')[-1], 'linked only', 0,
                environment, (library,))
        context.insert_user_function(entry, function, [library])
        state.reload_init.extend(library._reload_init)
        state['cr'] = state['cr']._replace(cfunc=entry)
        return True


class _WholeLibrary(JITCodeLibrary):
    """Code that holds all that it calls, under names that nothing outside of it sees."""

    def _optimize_final_module(self) -> None:
        # Numba numbers functions of one name and type in the order in which a process compiles
        # them. Code from the cache may hold the number of another function of this process, of
        # which the first to be loaded would be called by both.
        super()._optimize_final_module()
        for function in self._final_module.functions:
            if function.linkage == Linkage.linkonce_odr:
                function.linkage = 'internal'


@register_pass(mutates_CFG=True, analysis_only=False)
class _WholeLowering(NativeLowering):
    """Numba's last pass, into a library that shares nothing."""

    _name = 'whole_lowering'

    def run_pass(self, state: Any) -> bool:
        """Translate and load a function with all that it calls."""
        state.library = _WholeLibrary(state.targetctx.codegen(), state.func_id.func_qualname)
        state.library.enable_object_caching()
        return bool(super().run_pass(state))


class _Compiler(CompilerBase):
    """Numba's compiler with another last pass."""

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
    """For functions that are never called from Python."""

    lowering = _Lowering


class Whole(_Compiler):
    """For functions that nothing but Python calls."""

    lowering = _WholeLowering


class Part(CPUDispatcher):
    """
    A function that is compiled where compiled code calls it, once for all callers.

    Called from Python it is plain Python.

    Parameters
    ----------
    function : callable
        In numba's subset.
    targetoptions : dict
        For numba's compiler.
    others
        For numba, which rebuilds such an object from a cache on disk.

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
    """Return a decorator that makes a function a Part, with these options of numba.njit."""
    return lambda function: Part(function, targetoptions=options)


_OPTIONS: dict[str, Any] = {'nopython': True, 'no_cpython_wrapper': True, 'no_cfunc_wrapper': True}
# The same for what numba makes of a decorator such as register_jitable, once for each set of
# options that a caller has.
LINK_ONLY: dict[str, Any] = {'pipeline_class': LinkOnly, **_OPTIONS}


def _register(function: Callable[..., Any], inline: bool) -> None:
    """Let compiled code call a marked function."""
    register_jitable(**({'forceinline': True} if inline else {}), **LINK_ONLY)(function)


register_by(_register)


# A file begins with the version of numba that reads it, then the digest of the rest.
_MARK = b'hnn_vi_ros, numba '
_HEAD = _MARK + numba.__version__.encode() + b'\n'
# Other versions' files begin with these; before files had a digest, they were pickles.
_OTHERS = (_MARK, pickle.PROTO)


class _Files(IndexDataCacheFile):
    """
    Numba's files of a function, each with a digest and, inside, the place where it belongs.

    Damaged files, or files in the place of another, count as absent: a changed bit in machine code
    ends a process, or changes a number. Other versions' files count as absent as well.
    """

    # Files beside the source of the function, which another user may have compiled.
    beside: '_Files | None' = None

    def save(self, key: Any, data: Any) -> None:
        """Keep what belongs to a key."""
        super().save(key, (key, data))

    def load(self, key: Any) -> Any:
        """Return the entry of a key, None if there is none."""
        own, data = super().load(key) or (key, None)
        if data is None and self.beside is not None:
            return self.beside.load(key)
        if own != key:
            self._warn('files are in the place of others')
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
            file.write(_HEAD + sha256(data).digest() + data)

    def _read(self, path: str) -> Any:
        """Return what a file of this function holds, None if it cannot be used."""
        try:
            whole = Path(path).read_bytes()
        except FileNotFoundError:
            return None
        except OSError as problem:
            self._warn(problem.strerror or str(problem))
            return None
        head, digest, data = _parts(whole, len(_HEAD), sha256().digest_size)
        if head != _HEAD and head.startswith(_OTHERS):
            return None
        if head != _HEAD or sha256(data).digest() != digest:
            self._warn('files are damaged')
            return None
        try:
            name, content = pickle.loads(data)
        except Exception:
            # It comes from other sources, whose types no longer exist.
            return None
        if name != self._index_name:
            self._warn('files are in the place of others')
            return None
        return content

    def _warn(self, reason: str) -> None:
        _warn_once(f'compiled code in {self._cache_path} cannot be used', reason,
                   'it is compiled again')


def _parts(whole: bytes, *sizes: int) -> Iterator[bytes]:
    """Yield parts of bytes of these sizes, and the rest."""
    for size in sizes:
        yield whole[:size]
        whole = whole[size:]
    yield whole


_warned: set[str] = set()


def _warn_once(what: str, reason: str, then: str) -> None:
    """Warn of what comes of a reason, once for all files."""
    if then not in _warned:
        _warned.add(then)
        warnings.warn(f'{what} ({reason}): {then}', stacklevel=2)


class _Cache(FunctionCache):
    """
    Numba's cache on disk, which looks at all sources that a function comes from.

    Without it, as on a full disk, compiled code runs as well.
    """

    _cache_file: Any

    def __init__(self, py_func: Callable[..., Any]):
        super().__init__(py_func)
        files = self._cache_file
        described = files._index_name.removesuffix('.nbi'), files._source_stamp
        self._cache_file = _Files(self._cache_path, *described)
        beside = Path(py_func.__code__.co_filename).parent / '__pycache__'
        # A package that root has built and compiled is found by those who cannot write there: it
        # is trusted as its sources are. Who names a folder has all in that one.
        if not numba.config.CACHE_DIR and beside != Path(self._cache_path):
            self._cache_file.beside = _Files(str(beside), *described)

    def _index_key(self, signature: Any, codegen: Any) -> tuple[Any, ...]:
        digest = digest_of(frozenset([self._py_func.__module__]))
        return (*super()._index_key(signature, codegen), digest)

    def save_overload(self, sig: Any, data: Any) -> None:
        """Keep a compiled function; warn, once for all, that it cannot be kept."""
        try:
            super().save_overload(sig, data)
        except OSError as problem:
            _warn_of_lost(self._cache_path, problem.strerror or str(problem))


def _warn_of_lost(folder: str, reason: str) -> None:
    _warn_once(f'compiled code cannot be kept in {folder}', reason,
               'the next start compiles again; free space, or set NUMBA_CACHE_DIR to another '
               'folder')


def set_identity(dispatcher: CPUDispatcher, identity: str) -> None:
    """
    Let numba know a function by a name, in place of a number that is new in each process.

    Another thread may just be compiling a caller of the function, for which numba has numbered it:
    then its code is right all the same, but later processes do not find it on disk.
    """
    with suppress(AssertionError):
        dispatcher._set_uuid(identity)


# Wall time after which a process that has stopped is waited for no more, and between looks [s].
_LONGEST, _LOOK = 300.0, 0.02


@contextmanager
def _locked(cache: Any) -> Iterator[None]:
    """Lock the files of a function, where there can be any."""
    path = Path(cache._cache_path, f'{cache._cache_file._index_name}.lock')
    with ExitStack() as stack:
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            file = stack.enter_context(path.open('w'))
        except OSError:
            yield
            return
        until = time.monotonic() + _LONGEST
        while time.monotonic() < until:
            with suppress(BlockingIOError):
                flock(file, LOCK_EX | LOCK_NB)
                break
            time.sleep(_LOOK)
        try:
            yield
        finally:
            # Who waits has the file open; who comes later locks another, and finds the code.
            path.unlink(missing_ok=True)


def aside(dispatcher: CPUDispatcher) -> CPUDispatcher:
    """
    Have a function compiled in a thread of its own wherever the main thread wants it.

    Signals are handled by the main thread alone, between instructions of Python. Of those the
    first, after seconds of optimising, may be one of llvmlite's that swallows KeyboardInterrupt.
    """
    compile_ = dispatcher.compile

    def compile_once(signature: Any) -> Any:
        # By one process at a time: the others wait, and find it on disk.
        kept = isinstance(dispatcher._cache, _Cache)
        with _locked(dispatcher._cache) if kept else nullcontext():
            return compile_(signature)

    def compile_aside(signature: Any) -> Any:
        # Of what is compiled as a part of another only the whole is locked: no two wait for each
        # other.
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
    """Cache a function of this package on disk for as long as its sources stay unchanged."""
    try:
        dispatcher._cache = _Cache(dispatcher.py_func)
    except RuntimeError:
        _warn_of_lost('the package or a folder of caches', 'neither can be written')
    return aside(dispatcher)
