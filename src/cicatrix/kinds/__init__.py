"""Kinds of case, one package each; siblings never import each other."""
