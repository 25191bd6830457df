"""The documentation as a site: the READMEs as they stand, and pages that are made from the product when it is built.

    pip install -e '.[docs]' && properdocs build -f racerl/docs/properdocs.yml

A page per command (its help, its settings, what it says in the READMEs), a page per effect (its docstring, its
parameters, what came of it in the blind tests), the functions of `racerl.commands`. Needs a checkout.
"""
