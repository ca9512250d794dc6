# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
"""Common parts of the command lines of all executables."""

import argparse
from collections.abc import Sequence
import re
from textwrap import fill
from typing import NoReturn

from hnn_vi_ros.errors import did_you_mean, offered
from hnn_vi_ros.files.standard_streams import write_problem
from hnn_vi_ros.version import __version__

# Exit status for an invalid command line, as in argparse.
_USAGE_STATUS = 2
_HELP_WIDTH = 99


def complete_by(action: argparse.Action, kind: str) -> None:
    """Let shells complete an argument with names of a kind; see commands/completion.py."""
    setattr(action, 'names_of', kind)  # noqa: B010  argparse declares no such attribute


def seconds(text: str) -> float:
    """
    Return the number of seconds given by an argument; use it as the argument's type.

    Raises
    ------
    argparse.ArgumentTypeError
        The text is not a number, for example because it has a unit.

    """
    try:
        return float(text)
    except ValueError:
        raise argparse.ArgumentTypeError(
            f'{text!r} is not a number of seconds, e.g. 0.001') from None


class Parser(argparse.ArgumentParser):
    """
    Parser without abbreviations, whose errors are one line each.

    Parameters
    ----------
    name : str
        Name of the executable.
    description : str
        Purpose of the executable.
    examples : sequence of str
        Example command lines.
    details : str, optional
        Further text of the help, before the examples.
    parameters : sequence of str, optional
        ROS parameters, which users may mistake for options.

    """

    def __init__(self, name: str, description: str, examples: Sequence[str], details: str = '',
                 parameters: Sequence[str] = ()):
        shown = '\n'.join(f'  {example}' for example in examples)
        super().__init__(
            prog=f'hnn {name}'.strip(), description=fill(description, _HELP_WIDTH),
            allow_abbrev=False,
            epilog=f'{details}\n\nexamples:\n{shown}'.strip(),
            formatter_class=argparse.RawDescriptionHelpFormatter)
        self._parameters = parameters
        self.add_argument('--version', action='version', version=f'hnn_vi_ros {__version__}')

    @property
    def known(self) -> list[argparse.Action]:
        """Return all arguments, also of groups; argparse has no public list of them."""
        return self._actions

    @property
    def options(self) -> list[str]:
        """Return the strings of all options."""
        return [word for action in self.known for word in action.option_strings]

    def parse_args(  # type: ignore[override]  # nothing is added to a namespace of others
            self, args: Sequence[str], namespace: None = None) -> argparse.Namespace:
        """Return the parsed arguments, or exit with one line if they are invalid."""
        # Check this first: argparse would report a misspelt required option as missing.
        options, given = self.options, set[str]()
        # Options that add up begin with a list.
        repeated = {word for action in self.known if isinstance(action.default, list)
                    for word in action.option_strings}
        for word in args:
            option = word.partition('=')[0]
            if not option.startswith('--') or option == '--':
                continue
            if option in given:
                self.error(f'{option}: given twice; give it once')
            if option not in repeated:
                given.add(option)
            if option not in options:
                name = option.removeprefix('--').replace('-', '_')
                if name in self._parameters:
                    self.error(f'unknown option {option}; {name} is a parameter: --ros-args '
                               f'-p {name}:=VALUE')
                self.error(f'unknown option {option}{did_you_mean(option, options)}')
        found, unknown = self.parse_known_args(args, namespace)
        if unknown:
            self.error(f'unknown argument {unknown[0]!r}')
        return found

    def error(self, message: str) -> NoReturn:
        """Exit with a one-line error."""
        # Replace the names of Python types, which a user need not know.
        message = re.sub(r"invalid (int|float) value: ('.*')", lambda found: (
            f'{found[2]} is not a '
            f'{"whole " * (found[1] == "int")}number'), ' '.join(message.split()))
        message = re.sub(r"invalid choice: '(.*)' \(choose from (.*)\)", lambda found: (
            f'unknown {found[1]!r}{offered(found[1], found[2].replace(chr(39), "").split(", "))}'
            ), message)
        if message.startswith('the following arguments are required'):
            message = '; '.join([message, *(
                f'{action.metavar or action.dest} is one of {", ".join(action.choices)}' for action
                in self._actions if action.choices and action.required)])
        line = f'{self.prog}: {message}; see {self.prog} --help'
        write_problem(line)
        self.exit(_USAGE_STATUS)
