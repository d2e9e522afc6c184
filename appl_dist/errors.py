"""The one exception a user sees as a sentence; every role turns it into exit status 2, no traceback."""

from __future__ import annotations

import argparse
from typing import NoReturn


class UserError(Exception):
    """Something the user gave is wrong: says what, the value got, what is allowed, what to do."""


class ArgumentParser(argparse.ArgumentParser):
    """argparse's, whose complaints are UserErrors as everywhere else."""

    def error(self, message: str) -> NoReturn:
        raise UserError(f"{message}; {self.prog} --help lists what it takes")
