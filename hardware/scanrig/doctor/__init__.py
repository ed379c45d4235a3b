"""The examination of a rig, part after part: what works, what does not, what to do."""

from scanrig.doctor.doctor import Patient, examine
from scanrig.doctor.findings import Finding
from scanrig.doctor.light import stripe_level
