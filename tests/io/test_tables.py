"""Tables of users in every way that spreadsheets, instruments and editors save them; a fault names row, column and cell."""

import random
from pathlib import Path

import numpy as np
import pytest

from cicatrix.core.errors import InputError
from cicatrix.files.measurements import read_measurements
from cicatrix.files.networks import read_network
from cicatrix.files.numerals import Numerals, numerals_of
from cicatrix.files.tables import read_table
from cicatrix.files.text import text_of

NAMES = ("time_h", "lambda_x", "sigma_x_kPa")
ROWS = ((0.0, 1.0, 0.0), (0.25, 1.125, 0.7535), (1.5, 1.3, 1.84154))
POINT = [",".join(NAMES), *(",".join(map(str, row)) for row in ROWS)]
COMMA = [line.replace(",", ";").replace(".", ",") for line in POINT]
ENCODINGS = ["utf-8", "utf-8-sig", "utf-16", "utf-16-le", "utf-16-be", "utf-32", "utf-32-le", "utf-32-be", "latin-1"]


def lines(rows, end="\n"):
    return end.join(rows) + end


def read(path: Path, data: str | bytes):
    path = path / "data.csv"
    path.write_bytes(data if isinstance(data, bytes) else data.encode())
    table = read_table(path, NAMES)
    return table, table.numbers([name for name in NAMES if name in table.names])


def assert_rows(columns):
    np.testing.assert_array_equal(np.column_stack([columns[name] for name in NAMES]), ROWS)


SAVED = {
    "line feeds": lines(POINT),
    "carriage returns and line feeds": lines(POINT, "\r\n"),
    "carriage returns": lines(POINT, "\r"),
    "semicolons": lines([line.replace(",", ";") for line in POINT]),
    "tabs": lines([line.replace(",", "\t") for line in POINT]),
    "decimal commas": lines(COMMA),
    "decimal commas, tabs": lines([line.replace(";", "\t") for line in COMMA]),
    "decimal commas, quoted": lines(['"' + line.replace(";", '","') + '"' for line in COMMA]),
    "a comment above": '# tension, 21 C, 5" wide\n' + lines(POINT),
    "comments between": lines([POINT[0], POINT[1], "  # slipped", *POINT[2:]]),
    "blank lines": lines([*POINT[:2], "", ",,", *POINT[2:], ",,", ""]),
    "blanks around": lines([line.replace(",", " , ") for line in POINT]),
    "quotes and blanks": lines(['"time_h" , "lambda_x","sigma_x_kPa" ', *POINT[1:]]),
    "a title above": lines(["Sample 3,,", *POINT]),
    "titles of several cells above": lines(["Sample 3, left, 21 C", "", "Force, in N;0,5", *POINT]),
    "the end of a text in DOS": lines(POINT) + "\x1a",
    "the separator named": lines(["sep=;", *COMMA]),
    "an index": lines([f"{number},{line}" for number, line in zip(("", 1, 2, 3), POINT)]),
    "a text column with line breaks": lines([f'{line},"a\n# b, ""c"""' for line in [POINT[0], *POINT[1:]]]),
    "empty cells at the end": lines([POINT[0], *(f"{line},," for line in POINT[1:])]),
    "thousands": 'time_h,lambda_x,sigma_x_kPa\n0.0,1,"0.00"\n0.25,1.125,.7535\n"1.5",1.3,1.84154\n',
    "minus signs and exponents": lines([POINT[0], "-0,1E0,\N{MINUS SIGN}0", "2.5e-1,1.125,+0.7535", POINT[3]]),
}


@pytest.mark.parametrize("way", SAVED)
def test_the_same_numbers_however_they_are_saved(way, tmp_path):
    table, columns = read(tmp_path, SAVED[way])
    assert_rows(columns)
    assert table.notes == ()


@pytest.mark.parametrize("encoding", ENCODINGS)
def test_the_same_numbers_in_every_encoding(encoding, tmp_path):
    rows = [f"{line},{word}" for line, word in zip(POINT, ("what", "\N{MICRO SIGN}m", "\N{DEGREE SIGN}", ""))]
    table, columns = read(tmp_path, lines(rows).encode(encoding))
    assert_rows(columns)
    assert table.texts("what") == ["\N{MICRO SIGN}m", "\N{DEGREE SIGN}", ""]
    assert len(table.notes) == (encoding == "latin-1")
    assert all("(line 2); its letters were read as Windows-1252" in note for note in table.notes)


@pytest.mark.parametrize("missing", ["", "NA", "n/a", "NaN", "#N/A", '"NA"'])
def test_missing_values(missing, tmp_path):
    _, columns = read(tmp_path, lines([POINT[0], f"{missing},1.0,0.0", *POINT[2:]]))
    assert np.isnan(columns["time_h"]).tolist() == [True, False, False]


def test_a_cut_file_is_said(tmp_path):
    table, columns = read(tmp_path, "\n".join(POINT))
    assert_rows(columns)
    assert "no line break at its end" in table.notes[0]


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", "is empty: it must start with a row of column names, time_h, lambda_x, sigma_x_kPa"),
        ("\n# a\n", "is empty"),
        ("time_h,lambda_x\n", "has no rows below its column names"),
        ("1,2\n3,4\n", 'row 1 must hold the column names; got "1"'),
        ("# time_h,lambda_x\n0,1\n", 'row 2 must hold the column names; got "0" (a # makes a line a comment)'),
        ("time_h,lambda_x,time_h\n0,1,2\n", "column time_h is there twice"),
        ("time_h,lambda_x,Lambda_x\n0,1,2\n", "column lambda_x is there twice"),
        ("time_h,lambda_x\n(h),-\n0,1\n", "row 2 holds no number but (h), -: if these are units, delete the row"),
        ("time_h,lambda_x\n0,1\n1," + 140_000 * "1", "row 3 cannot be split into cells: a cell has more than 131072"),
        ("PK\x03\x04\x14\x00\x06\x00", "is a file of an office program, not text: save it from there as CSV"),
        ("time_h,lambda_x\n\n0,1\n1\n", "row 4 must have 2 columns, like the row of names; got 1"),
        ("time_h,lambda_x\n0,5,1,5\n", "got 4; numbers with a decimal comma need semicolons or tabs"),
        ("time_h,lambda_x\n0,1\n1,1_0.5\n", 'row 3, column lambda_x: "1_0.5" is not a number'),
        ("time_h,lambda_x\n#c\n0,one\n", 'row 3, column lambda_x: "one" is not a number'),
        ("time_h,lambda_x\n0,#DIV/0!\n", '"#DIV/0!" is not a number'),
        ("time_h,lambda_x\n#REF!,1\n", '"#REF!" is not a number'),
        ("time_h,lambda_x\n0,inf\n", '"inf" is not a number'),
        ("time_h,lambda_x\n0,1e999\n", '"1e999" is too large for a number'),
        ("time_h,lambda_x\n0,0x10\n", '"0x10" is not a number'),
        ("time_h,lambda_x\n0,\N{ARABIC-INDIC DIGIT ONE}\n", "is not a number"),
        ('time_h,lambda_x\n0.5,"1,234"\n', '"1,234" may be 1.234 or 1234: write one of the two'),
        ("time_h;lambda_x\n0,5;1.025\n", '"1.025" may be 1.025 or 1025'),
        ("time_h;lambda_x\n1;1,025\n", '"1,025" may be 1.025 or 1025'),
        ("time_h;lambda_x\n0.5;1,25\n1.5;1.25\n", '"1,25" is not a number with a decimal point, as in other cells'),
        ('time_h,lambda_x\n0,"1\n2,3\n', "row 2 cannot be split into cells"),
        ("time_h,lambda_x\n0,\x001\n", "is not a text file: line 2 has the control character U+0000"),
    ],
)
def test_a_fault_names_its_place(text, words, tmp_path):
    with pytest.raises(InputError) as caught:
        read(tmp_path, text)
    assert words in str(caught.value)
    assert "\n" not in str(caught.value)


def test_an_endless_cell_is_refused_at_once(tmp_path):
    for cell, words in (
        (200_000 * "1", "cannot be split into cells"),
        (100_000 * "1" + "x", "not a number"),
        (50_000 * ",.", "not a number"),
    ):
        with pytest.raises(InputError, match=words):
            read(tmp_path, f"time_h;lambda_x\n0;{cell}\n")


@pytest.mark.parametrize(
    ("texts", "numbers"),
    [
        (["1,234.5", "2,000"], [1234.5, 2000.0]),
        (["1.234,5", "2.000"], [1234.5, 2000.0]),
        (["1,234,567"], [1234567.0]),
        (["1.234.567", "0,5"], [1234567.0, 0.5]),
        (["0,125", "1,125"], [0.125, 1.125]),  # no group of thousands starts with 0
        (["1'234.5", "1\N{NARROW NO-BREAK SPACE}234"], [1234.5, 1234.0]),
        (["-1,5e-3"], [-0.0015]),
        (["\N{MINUS SIGN}0,5", "1'234,5"], [-0.5, 1234.5]),
        (["1.025", "3"], [1.025, 3.0]),
    ],
)
def test_decimal_marks_and_thousands(texts, numbers):
    written = numerals_of(texts)
    assert [written.number(text) for text in texts] == numbers


def test_no_thousands_where_groups_are_odd():
    for text in ("12,34.5", "1,2345", "0,123.5", "1,234,56", "1.5.2"):
        with pytest.raises(ValueError, match="is not a number"):
            Numerals(".", is_grouped=True).number(text)


@pytest.mark.parametrize(
    ("head", "words"),
    [
        ("Time_h,lambda_x,sigma_x_kPa", 'column time_h is missing (is it "Time_h"?)'),
        ("time [h],lambda_x,sigma_x_kPa", 'column time_h is missing (is it "time [h]"?)'),
        ("time_s,lambda_x,sigma_x_kPa", 'column time_h is missing: divide "time_s" by 3600'),
        ("time (min),lambda_x,sigma_x_kPa", 'divide "time (min)" by 60'),
        ("days,lambda_x,sigma_x_kPa", 'multiply "days" by 24'),
        ("time_h,strain,sigma_x_kPa", 'column lambda_x is missing: take 1 + "strain"'),
        ("time_h,strain_percent,sigma_x_kPa", 'take 1 + "strain_percent" / 100'),
        ("time_h,lambda_x,P_x_kPa", 'column sigma_x_kPa is missing: take "P_x_kPa" * lambda_x'),
        ("time_h,lambda_x,nominal stress", 'take "nominal stress" * lambda_x'),
        ("time_h,lambda_x,sigma_x_MPa", 'multiply "sigma_x_MPa" by 1000'),
        ("time_h,lambda_x,sigma_x_Pa", 'divide "sigma_x_Pa" by 1000'),
        ("time_h,lambda_x,q", "column sigma_x_kPa is missing; there are time_h, lambda_x, q"),
        ("time_h|lambda_x|sigma_x_kPa", "columns are separated by commas, semicolons or tabs"),
        ("time_h lambda_x sigma_x_kPa", "columns are separated by commas, semicolons or tabs"),
    ],
)
def test_a_missing_column_is_made_from_another(head, words, tmp_path):
    path = tmp_path / "data.csv"
    path.write_text(f"{head}\n{'0.5,1.5,2.5' if ',' in head else '0'}\n")
    found = read_measurements(path)
    name = next(name for name in NAMES if name not in found.columns)
    assert words in str(found.missing(name))


def test_only_regular_files_of_a_sane_size(tmp_path):
    with pytest.raises(InputError, match="device, a pipe or a socket"):
        read_table(Path("/dev/zero"))
    with pytest.raises(InputError, match="is a folder"):
        read_table(tmp_path)
    with pytest.raises(InputError, match="no such file"):
        read_table(tmp_path / "none.csv")
    (tmp_path / "large.txt").write_bytes(b"a" * 100)
    with pytest.raises(InputError, match="MB"):
        text_of(tmp_path / "large.txt", largest=99)


def test_whatever_the_bytes_a_table_is_read_or_refused(tmp_path):
    """Seeded mutations of good tables: no error but InputError, and numbers that are finite or missing."""
    draw, n_read = random.Random(1), 0
    seeds = [text.encode(draw.choice(ENCODINGS[:3])) for text in SAVED.values()]
    spice = [b"\x00", b"\xff\xfe", b"\xe9", b"1_0", b"nan", *(bytes([byte]) for byte in b'",;\t#\r\ne.-')]
    for _ in range(400):
        data = bytearray(draw.choice(seeds))
        for _ in range(draw.randint(1, 6)):
            at = draw.randrange(len(data) + 1)
            data[at : at + draw.randint(0, 3)] = draw.choice([*spice, bytes([draw.randrange(256)])])
        try:
            _, columns = read(tmp_path, bytes(data))
        except InputError:
            continue
        n_read += 1
        assert not any(np.isinf(column).any() for column in columns.values())
    assert n_read > 20


def test_a_network_of_two_tables_as_a_spreadsheet_saves_them(tmp_path):
    """Byte order mark, semicolons, decimal commas, Windows-1252 in a column of notes; a cell that is no number is told."""
    species = "\ufeffid;y_init;y_max;tau_h\r\nA;0;1;0,5\r\nB;0;1;1\r\n"
    reactions = "id;rule;weight;n;ec50;what\ni;=> A;0,5;1,4;0,5;\xb5\nr;A => B;1;1,4;0,5;\n"
    (tmp_path / "species.csv").write_bytes(species.encode())
    (tmp_path / "reactions.csv").write_bytes(reactions.encode("latin-1"))
    model = read_network(tmp_path / "species.csv", tmp_path / "reactions.csv")
    assert model.law.tau.tolist() == [1800.0, 3600.0]
    assert model.law.n.tolist() == [1.4, 1.4]
    assert "read as Windows-1252" in model.notes[0]
    (tmp_path / "species.csv").write_bytes(species.replace("0,5", "1_0,5").encode())
    with pytest.raises(InputError, match=r'species.csv: row 2, column tau_h: "1_0,5" is not a number'):
        read_network(tmp_path / "species.csv", tmp_path / "reactions.csv")
