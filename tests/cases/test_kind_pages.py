"""Check the pages of the kinds of case: up to date, every key in them with a meaning, every example accepted."""

import re
import tomllib

import pytest

import kinds
from cicatrix.cases.sentences import known_keys
from cicatrix.kinds.registry import KINDS, case_from, case_type, check_case


def toml_blocks(text):
    return re.findall(r"```toml\n(.+?)```", text, flags=re.S)


@pytest.fixture(params=list(KINDS))
def kind(request):
    return request.param


@pytest.fixture
def page(kind):
    return kinds.page_of(kind).read_text(encoding="utf-8")


def test_the_page_is_that_of_the_case_type(kind, page):
    """If this fails, run python docs/kinds.py."""
    assert page == kinds.updated(kind, page)
    assert page.count("<!-- keys -->") == 1
    assert page.count("<!-- example ") >= 1


def test_every_key_has_a_type_and_a_meaning(kind):
    sections = kinds.sections_of(kind)
    gaps = [
        f"{section.path}.{row.key}" for section in sections for row in section.rows if not (row.type and row.meaning)
    ]
    assert not gaps
    assert all(section.text for section in sections if section.path)
    with_number = [row for section in sections for row in section.rows if "number" in row.type]
    assert all(row.unit and row.range for row in with_number if not row.type.startswith("table"))


def test_no_key_is_left_out(kind):
    shown = {f"{section.path}.{row.key}".strip(".") for section in kinds.sections_of(kind) for row in section.rows}
    assert set(known_keys(case_type(kind))) - shown == set()


def test_the_examples_are_accepted(kind, page, tmp_path):
    """A file whole; a part of a case in place of the tables of the file that it names."""
    names = re.findall(r"<!-- example (\S+) -->", page)
    for name in names:
        assert check_case(kinds.DOCS.parent / name) == []
    first = kinds.DOCS.parent / names[0]
    for image in ("breast.nii.gz", "breast.seg.nrrd"):
        (tmp_path / image).touch()
    for block in toml_blocks(page):
        part = tomllib.loads(block)
        if "kind" not in part:
            whole = tomllib.loads(first.read_text(encoding="utf-8")) | part
            case_from(whole, tmp_path if "image" in part else first.parent)
