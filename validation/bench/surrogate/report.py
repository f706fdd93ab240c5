"""`docs/gns.md`: the sections, and what has to be said with them."""

from collections.abc import Sequence
from datetime import date

from validation.bench.accuracy.page import paragraph
from validation.bench.surrogate.models import Model, facts


def page(
    models: Sequence[Model], missing: Sequence[str], sections: Sequence[Sequence[str]], command: str, seconds: float
) -> str:
    """The page."""
    absent = f"Not there, and so not shown: {', '.join(f'`{name}`' for name in missing)}." if missing else ""
    lines = [
        "# The learned simulator beside the MPM",
        "",
        *paragraph(f"""
            `{command}`, {date.today().isoformat()}, {seconds:.0f} s. The models on scenes that are in no training set,
            against the MPM that made the training sets. A rollout begins **from rest**, with positions and velocities
            alone, or **from first frames**, with the MPM's first 0.05 s. {absent}
        """),
        "## The models",
        "",
        *facts(models),
        "",
        "Their cards, with the commands that made them, lie beside their weights in `gns/weights`.",
        "",
    ]
    for section in sections:
        lines += section
    return "\n".join(lines).rstrip("\n") + "\n"
