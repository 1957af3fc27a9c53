"""What the tests of several parts need."""

import signal

import pytest


@pytest.fixture
def interruptible():
    """Python's own answer to Ctrl-C: a suite that a script started in the background inherits that it is ignored."""
    inherited = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, inherited)
