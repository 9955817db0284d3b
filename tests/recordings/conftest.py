import pytest
from recordings_helpers import walks

from jaxreplay import Records


@pytest.fixture(scope="module")
def sequences():
    return walks()


@pytest.fixture(scope="module")
def records(sequences):
    return Records.from_sequences(*sequences)
