"""Printed boards: the file itself, drawn here by its own operators, is found by the detector, in millimetres."""

import json
import re

import numpy as np
import pytest

import jaxscan
from jaxscan.cli.main import main
from jaxscan.errors import OptionError, OutputError
from jaxscan.geometry import AprilGrid, Charuco, Chessboard, Circles
from jaxscan.report.prints import board_pages, pdf_of, svg_of
from jaxscan.vision import draw_print, find_corners


PER_MM = 4.0
"""Elements of the picture that a sheet is drawn as: about 100 per inch."""
BOARDS = {
    "charuco": Charuco(7, 5, 0.03, 0.0217, "DICT_4X4_50"),
    "chessboard": Chessboard(8, 5, 0.025),
    "circles": Circles(4, 11, 0.02, 0.013),
    "symmetric": Circles(7, 6, 0.024, 0.012, "symmetric"),
    "aprilgrid": AprilGrid(5, 4, 0.0085, 0.028),
}
NUMBER = r"-?\d+(?:\.\d+)?"


def sheets_of(pdf):
    """Width and height [mm] of every page, its ink and what is beside it, by the operators of the file."""
    text = pdf.decode("cp1252")
    boxes = re.findall(rf"/MediaBox \[0 0 ({NUMBER}) ({NUMBER})\]", text)
    for box, content in zip(boxes, re.findall(r"stream\n(.*?)\nendstream", text, re.DOTALL), strict=True):
        matrix = re.match(rf"({NUMBER}) 0 0 (-{NUMBER}) 0 ({NUMBER}) cm", content)
        # A point is 1/72 inch; y is turned round, so that all else is in millimetres from the upper left corner.
        assert [float(part) for part in matrix.groups()] == pytest.approx(
            [72 / 25.4, -72 / 25.4, float(box[1])], abs=1e-4
        )
        (clip, ink), rest = (
            re.search(r"q\n(.*?) W n\n(.*?)\nf\nQ", content, re.DOTALL).groups(),
            content.split("Q\n")[1],
        )
        yield [float(side) * 25.4 / 72 for side in box], rectangles(clip)[0], ink, rest


def rectangles(content):
    """x, y, width, height [rectangles, 4], mm."""
    found = re.findall(rf"({NUMBER}) ({NUMBER}) ({NUMBER}) ({NUMBER}) re", content)
    return np.array(found, float).reshape(-1, 4)


def circles(content):
    """x, y, radius [circles, 3], mm: each begins on its right, and its second quarter ends on its left."""
    paths = [
        np.array(line.replace("m", "").replace("c", "").split(), float) for line in content.split("\n") if "m" in line
    ]
    return np.array([[(path[0] + path[12]) / 2, path[1], (path[0] - path[12]) / 2] for path in paths]).reshape(-1, 3)


def draw(size, window, boxes, discs, beside=()):
    """The sheet as a camera that looks straight at it sees it, uint8: every element has the share of paper in it."""
    columns, rows = (round(side * PER_MM) for side in size)
    cover = np.zeros((rows, columns))
    for many, (low, high) in ((boxes, (window[:2], window[:2] + window[2:])), (beside, (-np.inf, np.inf))):
        for box in many:
            x0, y0 = np.maximum(box[:2], low)
            x1, y1 = np.minimum(box[:2] + box[2:], high)
            cover += np.outer(share(y0, y1, rows), share(x0, x1, columns))
    u, v = (np.arange(columns) + 0.5) / PER_MM, (np.arange(rows) + 0.5) / PER_MM
    for centre_x, centre_y, radius in discs:
        away = np.hypot(*np.meshgrid(u - centre_x, v - centre_y))
        cover += np.clip((radius - away) * PER_MM + 0.5, 0.0, 1.0)
    # Lines of the ruler lie over one another; ink does not.
    return np.rint(255 * (1 - np.clip(cover, 0.0, 1.0))).astype(np.uint8)


def share(low, high, count):
    edges = np.arange(count + 1) / PER_MM
    return np.clip(np.minimum(edges[1:], high) - np.maximum(edges[:-1], low), 0.0, None) * PER_MM


@pytest.mark.parametrize("board", BOARDS.values(), ids=BOARDS)
def test_the_sheet_is_found_with_its_numbers_and_millimetres(board):
    pages, notes = board_pages(board, "A4")
    ((size, window, ink, rest),) = sheets_of(pdf_of(pages, "board"))
    assert sorted(size) == pytest.approx([210.0, 297.0], abs=1e-3) and notes == []
    found = find_corners(draw(size, window, rectangles(ink), circles(ink), rectangles(rest)), board)
    assert found is not None and found.valid.all()
    # The window is the board's outline. A hundredth of a millimetre is 0.04 elements: the detector's own error.
    places = 1e3 * (board.places() - board.outline()[0]) + window[:2]
    np.testing.assert_allclose((found.q + 0.5) / PER_MM, places, atol=0.01)


@pytest.mark.parametrize("name", ["charuco", "aprilgrid", "chessboard"])
def test_the_ink_is_where_the_calibration_supposes_it(name):
    """Stripes are fitted through the print as `draw_print` draws it."""
    board = BOARDS[name]
    pages, _ = board_pages(board, "A4")
    ((_, window, ink, _),) = sheets_of(pdf_of(pages, "board"))
    known = draw_print(board)
    boxes = rectangles(ink) - [*window[:2], 0, 0]
    covered = (boxes[:, 2] * boxes[:, 3]).sum() / (window[2] * window[3])
    assert covered == pytest.approx(1.0 - known.mean(dtype=float), abs=1e-4)
    rows, columns = known.shape
    step = np.array(window[2:]) / (columns, rows)
    whole = np.argwhere((known == 0.0) | (known == 1.0))
    for row, column in np.random.default_rng(1).permutation(whole)[:300]:
        at = (np.array([column, row]) + 0.5) * step
        black = np.any(np.all((boxes[:, :2] < at) & (at < boxes[:, :2] + boxes[:, 2:]), axis=1))
        assert black == (known[row, column] == 0.0)


@pytest.mark.more
def test_sheets_that_are_cut_at_their_marks_and_joined_are_the_board():
    board = Charuco(12, 9, 0.03, 0.022, "DICT_5X5_250")
    pages, (note,) = board_pages(board, "A4")
    assert note == "4 sheets of A4, and a joint is never as true as a print; one sheet of A3 holds it"
    ink, edge = 0, 10.0
    for k, (_, window, boxes, _) in enumerate(sheets_of(pdf_of(pages, "board"))):
        low, high = window[:2], window[:2] + window[2:]
        cut = cuts(pages[k], window)
        first = np.array([k % 2 == 0, k < 2])
        if k == 0:
            seam = edge + cut - low
        # What is kept of the sheet, laid against the seams of the first.
        shift = np.where(first, edge - low, seam - cut)
        low, high = np.where(first, low, cut), np.where(first, cut, high)
        kept = np.concatenate([low + shift, high - low])
        ink = ink + (255.0 - draw((380, 290), kept, rectangles(boxes) + np.append(shift, (0, 0)), []))
    found = find_corners(np.rint(255.0 - ink).astype(np.uint8), board)
    assert found.valid.all()
    places = 1e3 * (board.places() - board.outline()[0]) + edge
    np.testing.assert_allclose((found.q + 0.5) / PER_MM, places, atol=0.01)


def cuts(page, window):
    """x and y of the marks of a sheet that has one neighbour beside and one below or above it, mm."""
    low, high = window[:2], window[:2] + window[2:]
    marks = [box for box in page.rectangles if box[3] < page.height - 17.0 - 1e-9]
    beside = [np.any(box[2:] <= low) or np.any(box[:2] >= high) for box in marks]
    assert len(marks) == 4 and all(beside)
    upright, level = ([box for box in marks if (box[3] - box[1] > box[2] - box[0]) == way] for way in (True, False))
    (x,), (y,) = {(box[0] + box[2]) / 2 for box in upright}, {(box[1] + box[3]) / 2 for box in level}
    return np.array([x, y])


def test_the_ruler_has_a_hundred_millimetres():
    pages, _ = board_pages(BOARDS["chessboard"], "letter")
    ruler = pages[0].rectangles
    assert sorted((pages[0].width, pages[0].height)) == [215.9, 279.4]
    assert ruler[:, 2].max() - ruler[:, 0].min() == pytest.approx(100.0)
    # Ends of the longest marks, every ten millimetres.
    long = ruler[(ruler[:, 3] - ruler[:, 1] > 2.9)]
    centres = np.sort(long[:, [0, 2]].mean(1))
    np.testing.assert_allclose(np.diff(centres)[1:-1], 10.0)
    (words,) = [text.text for text in pages[0].texts if "chessboard" in text.text]
    assert words == "chessboard, 8 x 5 inner corners, 25 mm; outermost corners 175 mm across, 100 mm down"


def test_svg_has_the_shapes_of_pdf():
    pages, _ = board_pages(BOARDS["aprilgrid"], "A4")
    ((_, _, ink, _),) = sheets_of(pdf_of(pages, "board"))
    svg = svg_of(pages[0], "board").decode()
    assert 'width="210mm" height="297mm" viewBox="0 0 210 297"' in svg or 'width="297mm" height="210mm"' in svg
    (path,) = re.findall(r'url\(#window\)" d="(.*?)"', svg)
    found = np.array(re.findall(rf"M({NUMBER}) ({NUMBER})H({NUMBER})V({NUMBER})H", path), float)
    found[:, 2:] -= found[:, :2]
    np.testing.assert_allclose(found, rectangles(ink), atol=2e-4)
    pages, _ = board_pages(BOARDS["circles"], "A4")
    ((_, _, ink, _),) = sheets_of(pdf_of(pages, "board"))
    svg = svg_of(pages[0], "board").decode()
    found = np.array(re.findall(rf"M({NUMBER}) ({NUMBER})a({NUMBER}) ", svg), float)
    found[:, 1] += found[:, 2]
    np.testing.assert_allclose(found, circles(ink), atol=2e-4)


def test_cross_references_lead_to_the_objects():
    pdf = pdf_of(board_pages(Chessboard(20, 12, 0.03), "A4")[0], "a (board) of \\ signs")
    (start,) = re.findall(rb"startxref\n(\d+)\n%%EOF", pdf)
    assert pdf[int(start) :].startswith(b"xref\n")
    for number, place in enumerate(re.findall(rb"(\d{10}) 00000 n ", pdf), 1):
        assert pdf[int(place) :].startswith(b"%d 0 obj\n" % number)
    for length, content in re.findall(rb"/Length (\d+) >>\nstream\n(.*?)\nendstream", pdf, re.DOTALL):
        assert len(content) == int(length)
    assert rb"/Title (a \(board\) of \\ signs)" in pdf and b"/PrintScaling /None" in pdf


def test_the_board_of_a_capture_and_of_a_rig(tmp_path, capsys):
    table = '[board]\ntype = "chessboard"\ncolumns = 8\nrows = 5\nsquare_mm = 25\n'
    (tmp_path / "capture.toml").write_text(f'kind = "calibration"\n{table}')
    for source in (tmp_path, tmp_path / "capture.toml"):
        assert main(["board", str(source), "-o", str(tmp_path / "a.pdf"), "--json", "-"]) == 0
        said = json.loads(capsys.readouterr().out)
        assert (said["sheets"], said["width_mm"], said["paper"]) == (1, pytest.approx(225.0), "A4")
    assert (tmp_path / "a.pdf").read_bytes() == pdf_of(
        *board_pages(BOARDS["chessboard"], "A4")[:1], BOARDS["chessboard"].describe()
    )
    for text, says in (
        (table.replace("8", "1"), "expected at least 3 each"),
        ("[camera]\nwidth = 3\n", "board: missing"),
    ):
        (tmp_path / "capture.toml").write_text(text)
        assert main(["board", str(tmp_path), "-o", str(tmp_path / "b.pdf")]) == 1
        assert says in capsys.readouterr().err and not (tmp_path / "b.pdf").exists()


def test_files_are_written_and_refused(tmp_path):
    board = Chessboard(20, 12, 0.03)
    assert jaxscan.save_board(board, tmp_path / "a.pdf", paper="A1") == [tmp_path / "a.pdf"]
    names = jaxscan.save_board(board, tmp_path / "b.svg")
    assert [path.name for path in names] == [f"b-{k}.svg" for k in range(1, 9)]
    assert all(path.read_bytes().startswith(b"<svg ") for path in names)
    with pytest.raises(OptionError, match=r"expected \.pdf or \.svg"):
        jaxscan.save_board(board, tmp_path / "c.png")
    with pytest.raises(OptionError, match=r"needs \d{3} sheets, expected at most 100"):
        jaxscan.save_board(Chessboard(50, 50, 0.06), tmp_path / "c.pdf")
    with pytest.raises(OutputError, match="does not exist"):
        jaxscan.save_board(board, tmp_path / "none" / "c.pdf")
    assert not (tmp_path / "c.pdf").exists()
