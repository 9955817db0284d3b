import atexit
import os
import shutil
import tempfile

import jax
import pytest
from hypothesis import settings

from jaxreplay.loop import tracker
from jaxreplay.machine import keep_compiled

jax.config.update("jax_numpy_rank_promotion", "raise")

settings.register_profile("repeatable", deadline=None, derandomize=True)
settings.load_profile("repeatable")

# One cache of compiled programs for all processes of a session: most of a test's time is compiling.
if "PYTEST_XDIST_WORKER" not in os.environ:
    os.environ["XDG_CACHE_HOME"] = cache = tempfile.mkdtemp(prefix="jaxreplay-tests-")
    atexit.register(shutil.rmtree, cache, ignore_errors=True)
keep_compiled()


def pytest_collection_modifyitems(items):
    """Start with the notebook: a long test at the end would leave the other process idle."""
    items.sort(key=lambda item: "test_notebooks" not in item.nodeid)


@pytest.fixture(scope="module")
def fewer_windows():
    """To compile less."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(tracker, "WINDOWS", (256,))
        yield
