"""Names and text from files, made safe for a terminal."""

LONGEST = 200
"""Number of letters of a name that are shown; longer names lose their middle."""


def printable(text: object, longest: int = LONGEST) -> str:
    """Text as one line of bounded length without control characters.

    Text from files may contain line breaks, control characters and direction marks, which forge
    lines, change colours and reverse words.
    """
    letters = (x if x.isprintable() else " " if x.isspace() else "?" for x in str(text))
    line = " ".join("".join(letters).split())
    if len(line) > longest:
        line = f"{line[: longest // 2]} ... {line[-longest // 2 :]}"
    return line
