"""Small SBML models for tests, written from MathML in short form."""

MATH = 'xmlns="http://www.w3.org/1998/Math/MathML"'
TIME = '<csymbol encoding="text" definitionURL="http://www.sbml.org/sbml/symbols/time">t</csymbol>'
RATE_OF = '<csymbol encoding="text" definitionURL="http://www.sbml.org/sbml/symbols/rateOf">rateOf</csymbol>'
CELL = '<compartment id="c" spatialDimensions="3" size="{size}" constant="{constant}"/>'


def sbml(inside, version=2, head=""):
    """Return a model of Level 3 that counts time in seconds."""
    core = f'http://www.sbml.org/sbml/level3/version{version}/core"'
    return f'<sbml xmlns="{core} level="3" version="{version}"{head}><model id="m" timeUnits="second">{inside}</model></sbml>'


def math(formula):
    """Return MathML of a nested tuple: ("times", "k", 2.0), "k", 2.0, "time"; a text that starts with < is MathML already."""
    return f"<math {MATH}>{content(formula)}</math>"


def content(formula):
    if isinstance(formula, tuple):
        head = formula[0] if formula[0].startswith("<") else f"<{formula[0]}/>"
        return f"<apply>{head}{''.join(map(content, formula[1:]))}</apply>"
    if isinstance(formula, float):
        return f"<cn>{formula}</cn>"
    return {"time": TIME}.get(formula, formula if formula.startswith("<") else f"<ci>{formula}</ci>")


def listed(kind, *parts):
    inside = "".join(parts)
    return f"<listOf{kind}>{inside}</listOf{kind}>" if inside else ""


def parameter(name, value=None, constant="false", more=""):
    given = "" if value is None else f' value="{value}"'
    return f'<parameter id="{name}"{given} constant="{constant}"{more}/>'


def species(name, amount=None, density=None, only="false", boundary="false", more=""):
    given = f'initialConcentration="{density}"' if amount is None else f'initialAmount="{amount}"'
    return (
        f'<species id="{name}" compartment="c" {given} hasOnlySubstanceUnits="{only}" boundaryCondition="{boundary}" '
        f'constant="false"{more}/>'
    )


def rule(kind, variable, formula):
    of = f' variable="{variable}"' if variable else ""
    return f"<{kind}Rule{of}>{math(formula)}</{kind}Rule>"


def side(kind, names):
    links = (name if name.startswith("<") else reference(name) for name in names)
    return listed(kind, *links)


def reference(name, number=1.0, more='constant="true"'):
    given = "" if number is None else f' stoichiometry="{number}"'
    return f'<speciesReference species="{name}"{given} {more}/>'


def reaction(name, left, right, formula, more=""):
    law = f"<kineticLaw>{math(formula)}</kineticLaw>"
    return f'<reaction id="{name}" reversible="false"{more}>{side("Reactants", left)}{side("Products", right)}{law}</reaction>'


def assignment(symbol, formula):
    return f'<initialAssignment symbol="{symbol}">{math(formula)}</initialAssignment>'


def event(trigger, sets, delay=None, priority=None, first="true", persistent="true", at_trigger="true"):
    """Return an event; ``sets`` maps variables to formulas."""
    later = "" if delay is None else f"<delay>{math(delay)}</delay>"
    rank = "" if priority is None else f"<priority>{math(priority)}</priority>"
    pairs = (f'<eventAssignment variable="{name}">{math(of)}</eventAssignment>' for name, of in sets.items())
    return (
        f'<event useValuesFromTriggerTime="{at_trigger}"><trigger initialValue="{first}" persistent="{persistent}">'
        f"{math(trigger)}</trigger>{rank}{later}{listed('EventAssignments', *pairs)}</event>"
    )


def cell(size=1.0, constant="true"):
    return listed("Compartments", CELL.format(size=size, constant=constant))
