"""The examination of a rig, part after part: what works, what does not, what to do."""

from scanrig.doctor.doctor import Patient as Patient
from scanrig.doctor.doctor import examine as examine
from scanrig.doctor.findings import Finding as Finding
from scanrig.doctor.light import stripe_level as stripe_level
