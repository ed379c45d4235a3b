"""Text that a terminal shows and never obeys."""


def printable(text: str) -> str:
    r"""`text` with every character that is not shown as a sign of its own written as an escape, such as `\x1b`.

    A name in a file of a stranger may hold commands for the terminal. Escaped are control characters (C0, DEL and C1,
    also tabs and line ends), bidirectional and other format characters, lone surrogates, separators of lines and
    paragraphs, and every space but the usual one.

    Args:
        text: Any string, also one that cannot be encoded.

    Returns:
        One line that any terminal shows as it stands.
    """
    if text.isprintable():
        return text
    return "".join(
        one if one.isprintable() else one.encode("unicode_escape", "surrogatepass").decode("ascii") for one in text
    )
