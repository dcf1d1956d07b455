"""How kernels are compiled: once, cached on disk, without holding the interpreter's lock.

Numba's cache looks only at the file of the function that is called, not at those whose functions
it inlines.  So the cache lies in a folder named by the content of all that is compiled: an edit
anywhere compiles anew, and never runs stale code.
"""

from __future__ import annotations

import hashlib
import os
import warnings
from collections.abc import Callable
from functools import cache, partial
from pathlib import Path
from typing import Any

import numba
from numba.core import config as numba_config

# Attributes of this module are made at run time.
settings: Any = numba_config
_PACKAGE = Path(__file__).parent
# Function pointers between kernels are called experimental; tests hold them to what they promise.
warnings.filterwarnings("ignore", category=numba.NumbaExperimentalFeatureWarning)
# All files whose functions are compiled: kernels, and the arithmetic of the camera models.
_COMPILED = ("**/*kernels.py", "cameras/*.py")


def kernel(function: Callable[..., Any]) -> Any:
    """Compile a function with numba when it is first called, and keep it on disk."""
    return _compiled(function, None)


def pointer(signature: Any) -> Callable[[Callable[..., Any]], Any]:
    """Compile a function at once, for one signature, so that other kernels can be handed it.

    The receiving kernel is compiled for an explicit signature too, with
    ``numba.types.FunctionType(signature)`` in this argument's place: it then serves all functions
    of that signature.  A function of :func:`kernel` in its place would be a type of its own, and
    numba would compile the receiver anew in each process.
    """
    return partial(_compiled, signatures=[signature])


def _compiled(function: Callable[..., Any], signatures: list[Any] | None) -> Any:
    """Compile without bounds checks; a division by zero gives infinity or NaN, as in numpy."""
    before = settings.CACHE_DIR
    settings.CACHE_DIR = str(cache_folder())
    try:
        return numba.njit(signatures, cache=True, nogil=True, error_model="numpy")(function)
    finally:
        settings.CACHE_DIR = before


@cache
def cache_folder() -> Path:
    """Return the folder of compiled kernels: NUMBA_CACHE_DIR, the package's, or the user's."""
    name = f"kernels-{_content_hash()}"
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
