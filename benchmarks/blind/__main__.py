"""`python -m benchmarks.blind`: draw the cases, diagnose them, score the answers; each step resumes.

With `--family rig` the cases are made as rigs make recordings; with `--family left-out` the term that is the
cause is left out of the catalogue; with `--family combined` each has two or three effects. The page gets its
sections on them when the family `effects` is scored after them. With `--seed` and `--cases` other sets can be
drawn, to develop on.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path

# The scored sets by family, seed and cases; and the one that the classifier of the baselines is trained on.
SCORED = {
    "effects": (26_11_28_21, 120),
    "rig": (26_11_23_01, 60),
    "left-out": (26_11_28_07, 40),
    "combined": (26_11_28_04, 40),
}
TRAINING, TRAINED = 2, 160
STEPS = ("draw", "answer", "train", "score")


def main() -> None:
    """Run all, or the steps that are asked for."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.blind", description=__doc__)
    parser.add_argument(
        "steps", nargs="*", metavar="STEP", help="some of draw, answer, train, score; all unless given"
    )
    parser.add_argument(
        "-o", "--output", type=Path, default=Path("proof-out"), help="folder  [default: proof-out]"
    )
    parser.add_argument("--family", choices=SCORED, default="effects", help="of cases  [default: effects]")
    parser.add_argument("--seed", type=int, help="of the cases  [default: the scored set's]")
    parser.add_argument("--cases", type=int, help="how many  [default: as many as the scored set has]")
    parser.add_argument("--jobs", type=int, default=2, help="processes  [default: 2]")
    given = parser.parse_args()
    steps = given.steps or STEPS
    unknown = sorted(set(steps) - set(STEPS))
    if unknown:
        parser.error(f"no step {unknown[0]!r}; there are draw, answer, train and score")
    seed, count = (
        asked if asked is not None else scored
        for asked, scored in zip((given.seed, given.cases), SCORED[given.family], strict=True)
    )
    if given.family != "effects":
        if "train" in given.steps:
            parser.error(f"no step 'train' for the family {given.family}; there are draw, answer and score")
        _other(parser, given.family, given.output, steps, seed, count, given.jobs)
        return
    from . import answers, exam

    cases, training = given.output / f"seed-{seed}", given.output / f"training-{TRAINING}"
    if "draw" in steps:
        exam.make(cases, seed, count, given.jobs)
    if "answer" in steps:
        answers.run(cases, given.jobs)
    if "train" in steps:
        exam.make(training, TRAINING, TRAINED, given.jobs)
        answers.run(training, given.jobs, answers.only_features)
    if "score" in steps:
        from . import combined_score, left_out_score, page, rig_page, score

        scored = score.read(cases, given.jobs)
        if not scored:
            parser.error(f"{cases}: no answers to score; run the step 'answer' first")
        trained = answers.features(training)
        keys = exam.keys(training) if trained else {}
        labels = (
            score.classified(scored, [(f, keys[name]) for name, f in trained.items()]) if trained else None
        )
        rig, left_out, combined = (
            section.read_text(encoding="utf-8") if section.exists() else not_yet
            for section, not_yet in (
                (given.output / "rig.md", rig_page.NOT_YET),
                (given.output / "left-out.md", left_out_score.NOT_YET),
                (given.output / "combined.md", combined_score.NOT_YET),
            )
        )
        sections = {"rig": rig, "left_out": left_out, "combined": combined}
        page.write(scored, labels, given.output / "proof.md", f"seed {seed}", len(exam.keys(cases)), sections)
        print(score.table(["what", "target", "reached"], score.overview(scored)))


def _other(
    parser: argparse.ArgumentParser,
    family: str,
    output: Path,
    steps: Sequence[str],
    seed: int,
    count: int,
    jobs: int,
) -> None:
    """The steps of the families beside the first."""
    from . import answers, combined, combined_score, exam, left_out, left_out_score, rig, rig_page, rig_score
    from .score import table

    made, by, scoring, writing = {
        "rig": (rig, answers.rig_answer, rig_score, rig_page),
        "left-out": (left_out, answers.left_out_answer, left_out_score, left_out_score),
        "combined": (combined, answers.plain_answer, combined_score, combined_score),
    }[family]
    cases = output / f"{family}-{seed}"
    if "draw" in steps:
        exam.make(cases, seed, count, jobs, made)
    if "answer" in steps:
        answers.run(cases, jobs, by)
    if "score" in steps:
        scored = scoring.read(cases)
        if not scored:
            parser.error(f"{cases}: no answers to score; run the step 'answer' first")
        writing.write(scored, output, f"seed {seed}", len(exam.keys(cases)))
        print(table(["what", "target", "reached"], scoring.overview(scored)))


if __name__ == "__main__":
    main()
