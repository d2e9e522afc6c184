"""Arguments of the commands that take no configuration. Apart from errors.py, so that actors start without argparse."""

from __future__ import annotations

import argparse
from typing import NoReturn

from appl_dist.errors import UserError


class ArgumentParser(argparse.ArgumentParser):
    """argparse's, whose complaints are UserErrors as everywhere else."""

    def error(self, message: str) -> NoReturn:
        raise UserError(f"{message}; {self.prog} --help lists what it takes")
