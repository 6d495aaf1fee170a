"""Expressions of laws: from text to a tree, by recursive descent. Nothing is executed.

sum     = product (("+" | "-") product)*
product = signed (("*" | "/") signed)*
signed  = ("+" | "-") signed | power
power   = atom (("^" | "**") signed)?
atom    = number | name | name "(" sum ("," sum)* ")" | "(" sum ")"
"""

from __future__ import annotations

import dataclasses
import functools
import re

from gtr_jax.errors import did_you_mean, excerpt

# Functions of an expression, and how many arguments each takes.
FUNCTIONS = {
    **dict.fromkeys(("exp", "log", "sqrt", "abs", "sign", "step", "sin", "cos", "tanh", "atan"), 1),
    **dict.fromkeys(("min", "max"), 2),
}
CONSTANTS = {"pi": 3.141592653589793}
MOST_CHARACTERS, DEEPEST, LARGEST = 400, 25, 1e30
_TOKEN = re.compile(
    r"\s*(?:(?P<number>(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?)|(?P<name>[A-Za-z_][A-Za-z0-9_]*)"
    r"|(?P<sign>\*\*|[-+*/^(),]))"
)
_SPELLED = str.maketrans({"−": "-", "·": "*", "×": "*"})


class ExpressionError(ValueError):
    """What is wrong with an expression, and the remedy, in one line without the place."""


@dataclasses.dataclass(frozen=True)
class Number:
    """A number of the expression."""

    value: float


@dataclasses.dataclass(frozen=True)
class Name:
    """A variable or a parameter."""

    name: str


@dataclasses.dataclass(frozen=True)
class Apply:
    """An operation: "+", "-", "*", "/", "^", "neg" or the name of a function.

    Attributes:
        op: which.
        parts: what it is applied to.
        text: as written, cut short, for messages.
    """

    op: str
    parts: tuple[Node, ...]
    text: str


Node = Number | Name | Apply


@functools.lru_cache(maxsize=256)
def parsed(text: str) -> Node:
    """The tree of an expression.

    Raises:
        ExpressionError: it is none, or too long or too deep.
    """
    if len(text) > MOST_CHARACTERS:
        raise ExpressionError(
            f"has {len(text)} characters; {MOST_CHARACTERS} are the most, so write a shorter law"
        )
    return _Reader(text.translate(_SPELLED)).whole()


def names_in(node: Node) -> frozenset[str]:
    """Names of the variables and parameters that an expression has."""
    if isinstance(node, Apply):
        return frozenset().union(*map(names_in, node.parts))
    return frozenset({node.name}) if isinstance(node, Name) else frozenset()


class _Reader:
    def __init__(self, text: str):
        self.text, self.tokens, self.at, self.depth = text, [], 0, 0
        place = 0
        while text[place:].strip():
            found = _TOKEN.match(text, place)
            if found is None:
                rest = text[place:].lstrip()
                raise ExpressionError(
                    f"cannot read '{excerpt(rest, 20)}'; write numbers, names, + - * / ^, brackets and "
                    f"{', '.join(FUNCTIONS)}"
                )
            kind = str(found.lastgroup)
            self.tokens.append((kind, found[kind], found.start(kind), found.end()))
            place = found.end()

    def whole(self) -> Node:
        if not self.tokens:
            raise ExpressionError("is empty; write for example size * T")
        tree = self.sum()
        if self.at < len(self.tokens):
            raise ExpressionError(
                f"expected an operator before '{self.seen()}'{self.after()}; write * for a product"
            )
        return tree

    def seen(self) -> str:
        """The next token; "" at the end."""
        return excerpt(self.tokens[self.at][1], 20) if self.at < len(self.tokens) else ""

    def after(self) -> str:
        """Where the next token stands, for a message."""
        before = self.text[: self.tokens[self.at - 1][3]] if self.at else ""
        return f" after '{before[-20:].strip()}'" if before.strip() else ""

    def taken(self, *signs: str) -> str | None:
        """The next token, if it is one of these signs, which is then passed."""
        if self.at < len(self.tokens) and self.tokens[self.at][:1] == ("sign",) and self.seen() in signs:
            self.at += 1
            return self.tokens[self.at - 1][1]
        return None

    def made(self, op: str, start: int, *parts: Node) -> Apply:
        """An operation that began at a token and ends before the next one."""
        return Apply(op, parts, excerpt(self.text[self.tokens[start][2] : self.tokens[self.at - 1][3]]))

    def sum(self) -> Node:
        return self.chain(("+", "-"), self.product)

    def product(self) -> Node:
        return self.chain(("*", "/"), self.signed)

    def chain(self, signs: tuple[str, ...], part) -> Node:
        start = self.at
        tree = part()
        while sign := self.taken(*signs):
            tree = self.made(sign, start, tree, part())
        return tree

    def signed(self) -> Node:
        self.depth += 1
        if self.depth > DEEPEST:
            raise ExpressionError(f"is nested deeper than {DEEPEST} levels; write a simpler law")
        start, sign = self.at, self.taken("+", "-")
        tree = self.power() if sign is None else self.signed()
        tree = self.made("neg", start, tree) if sign == "-" else tree
        self.depth -= 1
        return tree

    def power(self) -> Node:
        start = self.at
        base = self.atom()
        return self.made("^", start, base, self.signed()) if self.taken("^", "**") else base

    def atom(self) -> Node:
        if self.taken("("):
            tree = self.sum()
            self.closed()
            return tree
        if self.at == len(self.tokens) or self.tokens[self.at][0] == "sign":
            found = f"'{self.seen()}'" if self.at < len(self.tokens) else "its end"
            raise ExpressionError(
                f"expected a number, a name or '('{self.after()}, found {found}; complete the expression"
            )
        kind, text, start, _ = self.tokens[self.at]
        self.at += 1
        if kind == "number":
            value = float(text)
            if not value <= LARGEST:
                raise ExpressionError(f"{excerpt(text, 20)} is above {LARGEST:g}; write a smaller number")
            return Number(value)
        if self.taken("("):
            return self.called(text, start)
        if text in FUNCTIONS:
            raise ExpressionError(f"{text} is a function; write {text}(...)")
        return Number(CONSTANTS[text]) if text in CONSTANTS else Name(text)

    def called(self, name: str, start: int) -> Node:
        if name not in FUNCTIONS:
            raise ExpressionError(f"no function '{excerpt(name, 30)}'; {did_you_mean(name, FUNCTIONS)}")
        parts = [self.sum()]
        while self.taken(","):
            parts.append(self.sum())
        self.closed()
        if len(parts) != FUNCTIONS[name]:
            wanted = FUNCTIONS[name]
            raise ExpressionError(
                f"{name} takes {wanted} argument{'s' * (wanted > 1)}, not {len(parts)}; correct it"
            )
        return Apply(name, tuple(parts), excerpt(self.text[start : self.tokens[self.at - 1][3]]))

    def closed(self) -> None:
        if not self.taken(")"):
            found = f"found '{self.seen()}'" if self.at < len(self.tokens) else "found its end"
            raise ExpressionError(f"expected ')'{self.after()}, {found}; close the bracket")
