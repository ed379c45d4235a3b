"""Sentences about a session are read on a terminal and on a page, so that none names an option."""

import ast
import re
from pathlib import Path

import pytest
import scanrig
from scanrig.session import job


FILES = sorted(Path(scanrig.__file__).parent.rglob("*.py"))


@pytest.mark.parametrize("file", FILES, ids=lambda file: file.stem)
def test_no_sentence_names_an_option(file):
    tree = ast.parse(file.read_text())
    told = {id(node.value) for node in ast.walk(tree) if isinstance(node, ast.Expr)}
    said = [node.value for node in ast.walk(tree) if isinstance(node, ast.Constant) and id(node) not in told]
    assert not [text for text in said if isinstance(text, str) and re.search(r"(^|\s)--[a-z]{2}", text)]


def test_the_file_of_sentences_is_looked_at():
    assert Path(job.__file__) in FILES
