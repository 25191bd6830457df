"""The car as equations, executed by torch and CasADi alike."""
