# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""The command lines of the executables: what they have in common."""

import argparse
from collections.abc import Iterable, Sequence
from difflib import get_close_matches
from typing import NoReturn

from hnn_vi_ros.version import __version__

# The status of a command line that is not understood, as argparse has it.
_USAGE = 2


class Parser(argparse.ArgumentParser):
    """
    A parser that takes no abbreviations, and whose errors are one line each.

    Parameters
    ----------
    name : str
        Of the executable.
    description : str
        What it does.
    examples : sequence of str
        Command lines that show it.
    details : str, optional
        What its help tells beside the options, before the examples.

    """

    def __init__(self, name: str, description: str, examples: Sequence[str], details: str = ''):
        shown = '\n'.join(f'  {example}' for example in examples)
        super().__init__(
            prog=name, description=description, allow_abbrev=False,
            epilog=f'{details}\n\nexamples:\n{shown}'.strip(),
            formatter_class=argparse.RawDescriptionHelpFormatter)
        self.add_argument('--version', action='version', version=f'hnn_vi_ros {__version__}')

    def parse_args(  # type: ignore[override]  # nothing is added to a namespace of others
            self, args: Sequence[str], namespace: None = None) -> argparse.Namespace:
        """Return what the arguments say, or exit with one line if they are not understood."""
        # Before argparse misses what is required, of which this may be a misspelling. It has no
        # public list of the options, which groups add as well.
        options = list(self._option_string_actions)
        for word in args:
            option = word.partition('=')[0]
            if option.startswith('--') and option not in options and option != '--':
                self.error(f'unknown option {option}{did_you_mean(option, options)}')
        found, unknown = self.parse_known_args(args, namespace)
        if unknown:
            self.error(f'unknown argument {unknown[0]!r}')
        return found

    def error(self, message: str) -> NoReturn:
        """Exit with one line."""
        self.exit(_USAGE, f'{self.prog}: {" ".join(message.split())}; see {self.prog} --help\n')


def did_you_mean(word: str, known: Iterable[str]) -> str:
    """Return ``'; did you mean ...?'`` if a word is nearly a known one, else nothing."""
    nearest = get_close_matches(word, known, n=1, cutoff=0.7)
    return f'; did you mean {nearest[0]}?' if nearest else ''
