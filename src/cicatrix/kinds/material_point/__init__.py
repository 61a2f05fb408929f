"""A constitutive law at one material point, without a mesh."""
