"""Calls that must raise an error or issue a warning."""

import pytest

import rfpsurvey as rs


def refused(message, call, /, *arguments, **options):
    """Check that a call raises an `InputError` whose text matches a pattern (or any text), and return the text."""
    with pytest.raises(rs.InputError, match=message or None) as caught:
        call(*arguments, **options)
    return str(caught.value)


def warned(message, call, /, *arguments, **options):
    """Check that a call issues a warning of the package whose text matches a pattern, and return the result."""
    with pytest.warns(rs.RfpsurveyWarning, match=message):
        return call(*arguments, **options)
