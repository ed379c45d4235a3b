"""Many captures as one project: what is to be made of each, and what of it is there already."""

from jaxscan.project.config import PRODUCTS, ProjectFile, load_project_file
from jaxscan.project.project import Project, ProjectCapture, load_project
from jaxscan.project.steps import Step, digest_of, steps_of
