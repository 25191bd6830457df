"""Three notebooks, as Python files: VS Code, PyCharm and Jupyter (with Jupytext) open them cell by cell.

`first_policy`     a policy for a car, trained, raced and looked at
`my_own_log`       from the log of your car to its parameters
`what_is_missing`  what your car does that your model does not

They run as scripts, too: `python racerl/notebooks/first_policy.py`. With the word `quick` behind it each runs through
in seconds, to see that all works; what comes out then is worth little. Results lie in `outputs/`, where you run them.
"""
