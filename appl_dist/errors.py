"""The one exception a user sees as a sentence; every role turns it into exit status 2, no traceback."""


class UserError(Exception):
    """Something the user gave is wrong: says what, the value got, what is allowed, what to do."""
