"""A GRBL board without hardware: a program on a pseudo terminal, written from GRBL's documentation."""

from bench.grbl.board import GrblBoard
