"""Figures beside their limits: renderers, decoder, solver."""
