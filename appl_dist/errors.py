"""Errors that a user sees as one sentence, and the exit statuses that go with them. Every role catches them."""

USER_ERROR = 2  # exit status of a user's mistake: another start would only repeat it
PASSING = 75  # exit status of a launcher's child for what may pass by itself (EX_TEMPFAIL)
PARENT_VARIABLE = "APPL_DIST_PARENT"  # in a child's environment: the launcher's process number


class UserError(Exception):
    """Something the user gave is wrong: says what, the value got, what is allowed, what to do."""


class PassingFault(UserError):
    """Something that may pass by itself, such as a learner that is not there yet."""
