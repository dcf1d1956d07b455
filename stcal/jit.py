"""How kernels are compiled: once, cached on disk, without holding the interpreter's lock.

Numba's cache looks only at the file of the function that is called, not at those whose functions
it inlines.  So the cache lies in a folder named by the content of all that is compiled: an edit
anywhere compiles anew, and never runs stale code.
"""

from __future__ import annotations

import hashlib
import os
import shutil
import sys
import time
import warnings
from collections.abc import Callable, Iterator, Mapping
from contextlib import suppress
from functools import cache, partial
from importlib import import_module
from pathlib import Path
from typing import Any, TypeVar

import numba
from numba.core import config as numba_config
from numba.core import event as numba_event

T = TypeVar("T")

# Attributes of this module are made at run time.
settings: Any = numba_config
events: Any = numba_event
_PACKAGE = Path(__file__).parent
# Function pointers between kernels are called experimental; tests hold them to what they promise.
warnings.filterwarnings("ignore", category=numba.NumbaExperimentalFeatureWarning)
# All files whose functions are compiled: kernels, and the arithmetic of the camera models.
_COMPILED = ("**/*kernels.py", "cameras/*.py")
_NAME = "kernels-"
# A cache that no process has used for so long belongs to a version that is gone.
_STALE_S = 30 * 86400.0
_ANNOUNCEMENT = (
    "stcal: compiling kernels for this machine, once: about 25 s, a minute for a sequential fit"
)


def kernel(function: Callable[..., Any]) -> Any:
    """Compile a function with numba when it is first called, and keep it on disk."""
    return _compiled(function, None)


def pointer(signature: Any) -> Callable[[Callable[..., Any]], Any]:
    """Compile a function at once, for one signature, so that other kernels can be handed it.

    The receiving kernel is compiled for an explicit signature too, with
    ``numba.types.FunctionType(signature)`` in this argument's place: it then serves all functions
    of that signature.  A function of :func:`kernel` in its place would be a type of its own, and
    numba would compile the receiver anew in each process.

    As the module that holds it compiles when it is imported, tables of pointers are
    :class:`KernelTable`.
    """
    return partial(_compiled, signatures=[signature])


class KernelTable(Mapping[str, T]):
    """Kernels by name: the module of an entry is imported when it is asked for.

    So that a run compiles only what it uses.
    """

    def __init__(self, modules: dict[str, str], entry: Callable[[Any], T]) -> None:
        """Take the modules by name, and what makes an entry of a module."""
        self._modules, self._entry = modules, entry

    def __getitem__(self, name: str) -> T:
        """Import the module of ``name`` and return its entry."""
        return self._entry(import_module(self._modules[name]))

    def __iter__(self) -> Iterator[str]:
        """Iterate over the names, importing nothing."""
        return iter(self._modules)

    def __len__(self) -> int:
        """Return the number of names."""
        return len(self._modules)


def _compiled(function: Callable[..., Any], signatures: list[Any] | None) -> Any:
    """Compile without bounds checks; a division by zero gives infinity or NaN, as in numpy."""
    before = settings.CACHE_DIR
    folder = cache_folder()
    _take_up(folder)
    settings.CACHE_DIR = str(folder)
    try:
        return numba.njit(signatures, cache=True, nogil=True, error_model="numpy")(function)
    finally:
        settings.CACHE_DIR = before


@cache
def cache_folder() -> Path:
    """Return the folder of compiled kernels: NUMBA_CACHE_DIR, the package's, or the user's."""
    name = _NAME + _content_hash()
    given = os.environ.get("NUMBA_CACHE_DIR")
    if given:
        return Path(given) / name
    beside = _PACKAGE / "__pycache__"
    try:
        beside.mkdir(exist_ok=True)
        writable = os.access(beside, os.W_OK)
    except OSError:
        writable = False
    return (beside if writable else Path.home() / ".cache" / "stcal") / name


def _content_hash() -> str:
    content = hashlib.sha256()
    for path in sorted({path for pattern in _COMPILED for path in _PACKAGE.glob(pattern)}):
        content.update(path.read_bytes())
    return content.hexdigest()[:16]


@cache
def _take_up(folder: Path) -> None:
    """Note that the cache is in use; when it is empty, clear old ones away and tell the user."""
    if next(folder.rglob("*.nbi"), None) is None:
        remove_stale(folder)
        events.register("numba:compile", _Announcement())
    else:
        with suppress(OSError):
            os.utime(folder)


def remove_stale(current: Path) -> None:
    """Remove the caches beside the current one that no process has taken up for a month."""
    for folder in current.parent.glob(_NAME + 16 * "[0-9a-f]"):
        # Another process may do the same at this moment.
        with suppress(OSError):
            if folder != current and folder.stat().st_mtime < time.time() - _STALE_S:
                shutil.rmtree(folder, ignore_errors=True)


class _Announcement(numba_event.Listener):
    """Tells the user why nothing seems to happen, at the first compilation."""

    def __init__(self) -> None:
        self.told = False

    def on_start(self, event: Any) -> None:
        """Print once."""
        if not self.told:
            self.told = True
            print(_ANNOUNCEMENT, file=sys.stderr, flush=True)

    def on_end(self, event: Any) -> None:
        """Nothing more to tell."""
