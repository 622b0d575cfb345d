"""What all tests share: the kernel that they run on, and examples that are the same every time."""

from __future__ import annotations

import importlib.util
import os
import sys

from hypothesis import settings

settings.register_profile("everyday", derandomize=True, deadline=None)  # the machine's load must not fail a test
settings.load_profile("everyday")


def _use_kernel(path: str) -> None:
    """Put the extension module at `path` (`make test-sanitize`) in the place of the installed one."""
    name = "lodpipe.kernel._native"
    spec = importlib.util.spec_from_file_location(name, path)
    if spec is None or spec.loader is None:
        raise ImportError(f"{path} is not an extension module")
    sys.modules[name] = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(sys.modules[name])


if "LODPIPE_TEST_KERNEL" in os.environ:
    _use_kernel(os.environ["LODPIPE_TEST_KERNEL"])
