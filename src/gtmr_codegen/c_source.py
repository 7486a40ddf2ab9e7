# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""CasADi expressions as plain C99, several points in a call."""

import casadi as ca

BINARY = {
    ca.OP_ADD: "+",
    ca.OP_SUB: "-",
    ca.OP_MUL: "*",
    ca.OP_DIV: "/",
    ca.OP_LT: "<",
    ca.OP_LE: "<=",
    ca.OP_EQ: "==",
    ca.OP_NE: "!=",
    ca.OP_AND: "&&",
    ca.OP_OR: "||",
}
UNARY = {
    ca.OP_ASSIGN: "{0}",
    ca.OP_NEG: "-{0}",
    ca.OP_SQ: "{0} * {0}",
    ca.OP_TWICE: "{0} + {0}",
    ca.OP_INV: "1.0 / {0}",
    ca.OP_NOT: "!{0}",
    ca.OP_IF_ELSE_ZERO: "{0} != 0.0 ? {1} : 0.0",
}
CALLS = {
    ca.OP_SIN: "sin",
    ca.OP_COS: "cos",
    ca.OP_SQRT: "sqrt",
    ca.OP_FABS: "fabs",
    ca.OP_FMIN: "fmin",
    ca.OP_FMAX: "fmax",
    ca.OP_EXP: "exp",
    ca.OP_LOG: "log",
    ca.OP_POW: "pow",
    ca.OP_CONSTPOW: "pow",
    ca.OP_TANH: "tanh",
    ca.OP_ATAN2: "atan2",
    ca.OP_HYPOT: "hypot",
}


def c_function(function: ca.Function, number: str = "double") -> str:
    """Write an SX function as a C function of one array in and one array out.

    It is ``void <name>(const <number> *restrict in, <number> *restrict out)``: the inputs follow
    each other in ``in``, the nonzeros of the outputs in ``out``. A number is a ``double``, or a
    vector of doubles that holds one point a lane, for which ``<number>_sin`` and the like must
    exist. Raises NotImplementedError for an operation that has no C counterpart here.
    """
    first_in = _offsets([function.nnz_in(i) for i in range(function.n_in())])
    first_out = _offsets([function.nnz_out(i) for i in range(function.n_out())])
    prefix = "" if number == "double" else f"{number}_"
    names: dict[int, str] = {}
    constants: dict[str, float] = {}
    written: set[str] = set()
    lines = []

    def define(name: str, value: str) -> str:
        """Name a value, once."""
        if name not in written:
            written.add(name)
            lines.append(f"const {number} {name} = {value};")
        return name

    def operand(i: int) -> str:
        name = names[i]
        return define(name, _constant(constants[name], number)) if name in constants else name

    for k in range(function.n_instructions()):
        op, to, of = (
            function.instruction_id(k),
            function.instruction_output(k),
            function.instruction_input(k),
        )
        if op == ca.OP_OUTPUT:
            lines.append(f"out[{first_out[to[0]] + to[1]}] = {operand(of[0])};")
            continue
        name = f"t{k}"
        if op == ca.OP_INPUT:
            define(name, f"in[{first_in[of[0]] + of[1]}]")
        elif op == ca.OP_CONST:
            # Written where it is used, as far as it is.
            constants[name] = function.instruction_constant(k)
        elif op == ca.OP_DIV and number != "double":
            # A vector is divided many times as slowly as it is multiplied.
            by = names[of[1]]
            if by in constants:
                inverse = _constant(1.0 / constants[by], number)
            else:
                inverse = define(f"inverse_{by}", f"1.0 / {by}")
            define(name, f"{operand(of[0])} * {inverse}")
        else:
            define(name, _expression(op, [operand(i) for i in of], prefix))
        names[to[0]] = name
    body = "\n".join(f"    {line}" for line in lines)
    name = function.name()
    return f"void {name}(const {number} *restrict in, {number} *restrict out)\n{{\n{body}\n}}\n"


def _offsets(sizes: list[int]) -> list[int]:
    return [sum(sizes[:i]) for i in range(len(sizes))]


def _constant(value: float, number: str) -> str:
    return repr(float(value)) if number == "double" else f"{number}_of({float(value)!r})"


def _expression(op: int, operands: list[str], prefix: str) -> str:
    if op in BINARY:
        return f"{operands[0]} {BINARY[op]} {operands[1]}"
    if op in UNARY:
        return UNARY[op].format(*operands)
    if op in CALLS:
        return f"{prefix}{CALLS[op]}({', '.join(operands)})"
    raise NotImplementedError(f"CasADi operation {op} has no C counterpart")
