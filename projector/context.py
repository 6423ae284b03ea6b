"""The OpenGL context: EGL (a GPU, or Mesa's llvmpipe) first, then the platform's; else one clear line.

Contexts are current per thread, so each thread that asks gets a separate one.
A process that was forked from one that had one gets none: it would wait for ever for the driver's threads,
which stay behind.
"""

import os
import threading
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any, TypeVar

import moderngl

__all__ = ["ContextInfo", "NoContextError", "checked", "context", "context_info", "free", "keep"]

T = TypeVar("T")

_PACKAGES = "libegl1 libgl1 libgl1-mesa-dri"
_REQUIRE = 330
# Debian's run-time packages have the versioned names only; the unversioned ones come with the -dev packages.
_EGL: Mapping[str, Any] = {"backend": "egl", "libgl": "libGL.so.1", "libegl": "libEGL.so.1"}
_EGL_DEVICES = 8
_ATTEMPTS: tuple[Mapping[str, Any], ...] = (
    *({**_EGL, "device_index": device} for device in range(_EGL_DEVICES)),
    {},
)


class NoContextError(RuntimeError):
    """No OpenGL context can be made here; the message is one line and names the packages to install."""


@dataclass(frozen=True, slots=True)
class ContextInfo:
    """Renderer and limits of a context: for `doctor` and for the reports."""

    backend: str
    renderer: str
    version: str
    max_attachments: int
    max_texture: int

    def __str__(self) -> str:
        return f"{self.renderer}, OpenGL {self.version}, {self.backend}"


class _Local(threading.local):
    context: moderngl.Context | None = None
    backend: str = ""
    kept: dict[str, Any]  # GL objects that live as long as the context, by name


_local = _Local()
_drawn: set[int] = set()  # processes, this one or those it was forked from, that have had a context


def _forked() -> bool:
    return bool(_drawn - {os.getpid()})


def _require_own_driver() -> None:
    if _forked():
        raise NoContextError(
            "no OpenGL context in a process that was forked from one that has drawn (the driver's threads "
            "stay behind); start it by multiprocessing's 'spawn', or draw with renderer 'numpy'"
        )


def context() -> moderngl.Context:
    """This thread's context, made at the first call. NoContextError (one line) where none can be made."""
    _require_own_driver()
    if _local.context is None:
        _local.context, _local.backend = _create()
        _local.kept = {}
        _drawn.add(os.getpid())
        # Objects that nobody released are collected there, for tests to count.
        _local.context.gc_mode = "context_gc"
    return _local.context


def keep(name: str, make: Callable[[moderngl.Context], T]) -> T:
    """An object of this thread's context, made at the first call."""
    ctx = context()
    if name not in _local.kept:
        _local.kept[name] = make(ctx)
    found: T = _local.kept[name]
    return found


def context_info() -> ContextInfo:
    """Describe this thread's context. NoContextError where none can be made."""
    info = context().info
    return ContextInfo(
        backend=_local.backend,
        renderer=info["GL_RENDERER"],
        version=info["GL_VERSION"],
        max_attachments=min(info["GL_MAX_COLOR_ATTACHMENTS"], info["GL_MAX_DRAW_BUFFERS"]),
        max_texture=info["GL_MAX_TEXTURE_SIZE"],
    )


def free(ctx: moderngl.Context, *items: Any) -> None:
    """Release GL objects; none of the framebuffers stays bound (moderngl would bind a deleted one again)."""
    if _forked():
        return
    ctx.detect_framebuffer(0).use()
    for item in items:
        item.release()


@contextmanager
def checked(ctx: moderngl.Context) -> Iterator[moderngl.Context]:
    """Run a block of GL work; an error that the driver holds afterwards is raised here, not met later."""
    _require_own_driver()
    _raise_error(ctx, "before")
    yield ctx
    _raise_error(ctx, "during")


def _raise_error(ctx: moderngl.Context, when: str) -> None:
    error = ctx.error
    if error != "GL_NO_ERROR":
        raise RuntimeError(f"OpenGL error {when} this work: {error}")


def _create() -> tuple[moderngl.Context, str]:
    reasons: dict[str, None] = {}
    for attempt in _ATTEMPTS:
        backend = attempt.get("backend", "default")
        try:
            return moderngl.create_context(standalone=True, require=_REQUIRE, **attempt), backend
        except Exception as error:  # glcontext raises bare Exception
            if "requested device index" not in str(error) or not reasons:
                reasons[f"{backend}: {' '.join(str(error).split())}"] = None
    raise NoContextError(
        f"no OpenGL {_REQUIRE // 100}.{_REQUIRE % 100 // 10} context ({'; '.join(reasons)}); "
        f"on Debian: apt-get install {_PACKAGES}"
    )
