"""`python -m benchmarks.blind`: draw the cases, diagnose them, score the answers; each step resumes.

With `--seed` and `--cases` other sets can be drawn, to develop on.
"""

from __future__ import annotations

import argparse
from pathlib import Path

# The scored set, and the one that the classifier of the baselines is trained on.
SEED, CASES, TRAINING, TRAINED = 26_11_23_22, 320, 2, 160
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
    parser.add_argument("--seed", type=int, default=SEED, help="of the cases  [default: the scored set's]")
    parser.add_argument("--cases", type=int, default=CASES, help=f"how many  [default: {CASES}]")
    parser.add_argument("--jobs", type=int, default=2, help="processes  [default: 2]")
    given = parser.parse_args()
    steps = given.steps or STEPS
    unknown = sorted(set(steps) - set(STEPS))
    if unknown:
        parser.error(f"no step {unknown[0]!r}; there are draw, answer, train and score")
    from . import answers, exam

    cases, training = given.output / f"seed-{given.seed}", given.output / f"training-{TRAINING}"
    if "draw" in steps:
        exam.make(cases, given.seed, given.cases, given.jobs)
    if "answer" in steps:
        answers.run(cases, given.jobs)
    if "train" in steps:
        exam.make(training, TRAINING, TRAINED, given.jobs)
        answers.run(training, given.jobs, features_only=True)
    if "score" in steps:
        from . import page, score

        scored = score.read(cases, given.jobs)
        if not scored:
            parser.error(f"{cases}: no answers to score; run the step 'answer' first")
        trained = answers.features(training)
        keys = exam.keys(training) if trained else {}
        labels = (
            score.classified(scored, [(f, keys[name]) for name, f in trained.items()]) if trained else None
        )
        page.write(scored, labels, given.output / "proof.md", f"seed {given.seed}", len(exam.keys(cases)))
        print(score.table(["what", "target", "reached"], score.overview(scored)))


if __name__ == "__main__":
    main()
