"""What a figure has shown: a table beside the paper's numbers, and one sentence on the rest."""

from __future__ import annotations

from hpccomponent.dataclass import dataclass


@dataclass(frozen=True, slots=True)
class Finding:
    """What came of one figure of the paper: which, and of what; rows of as many cells as columns.

    The sentence says where it differs from the paper, and why; the other one what is on the
    picture, from left to right.
    """

    title: str
    columns: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    sentence: str
    picture: str

    def to_markdown(self, picture: str) -> str:
        """Return the page of this figure, beside which the picture's file of that name is.

        Examples
        --------
        >>> finding = Finding("Figure 0", ("a", "b"), (("1", "2"),), "As printed.", "A dot.")
        >>> print(finding.to_markdown("dot.png"))
        # Figure 0
        <BLANKLINE>
        | a | b |
        |---|---|
        | 1 | 2 |
        <BLANKLINE>
        As printed.
        <BLANKLINE>
        ![A dot.](dot.png)
        <BLANKLINE>
        A dot.
        <BLANKLINE>
        """
        lines = [f"| {' | '.join(cells)} |" for cells in (self.columns, *self.rows)]
        lines.insert(1, "|" + "---|" * len(self.columns))
        table = "\n".join(lines)
        shown = f"![{self.picture}]({picture})\n\n{self.picture}\n"
        return f"# {self.title}\n\n{table}\n\n{self.sentence}\n\n{shown}"
