"""One test for a rule that every file has to keep."""

import ast
import functools
from pathlib import Path


@functools.cache
def tree_of(path):
    """A file, parsed once for all rules. Do not change it."""
    return ast.parse(Path(path).read_text())


def for_every(paths, name=str):
    """Makes one test of an assertion about a path; it fails with a line for each path that breaks the rule.

    A test for each file and rule would cost thousands of times what starts and ends a test.
    """
    paths = list(paths)

    def decorate(rule):
        # Not functools.wraps: pytest would look for a fixture of the rule's argument's name.
        def test():
            assert paths, "no files"
            broken = []
            for path in paths:
                try:
                    rule(path)
                except AssertionError as problem:
                    broken.append(f"{name(path)}: {problem}")
            assert not broken, "\n".join(broken)

        test.__name__, test.__doc__, test.__module__ = rule.__name__, rule.__doc__, rule.__module__
        return test

    return decorate
