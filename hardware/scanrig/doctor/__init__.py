"""Examines a rig, part after part: reports faults and remedies."""

from scanrig.doctor.doctor import Patient, examine
from scanrig.doctor.findings import Finding
from scanrig.doctor.light import judge_exposure, stripe_level
