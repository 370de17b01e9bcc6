"""Names and text from files, as a terminal may be given them."""

LONGEST = 200
"""Number of letters of a name that is shown; longer ones lose their middle."""


def printable(text: object, longest: int = LONGEST) -> str:
    """Bring a name or text to one line of bounded length that steers no terminal.

    Line breaks, control characters and marks of direction come from files too; they forge lines,
    change colours, and turn words round.
    """
    letters = (x if x.isprintable() else " " if x.isspace() else "?" for x in str(text))
    line = " ".join("".join(letters).split())
    if len(line) > longest:
        line = f"{line[: longest // 2]} ... {line[-longest // 2 :]}"
    return line
