"""Physical groups of a vehicle's parameters: numbers that are configured wrongly together, in the words of a user.

Mass is weighed, and motion shows only ratios to it; more drag than configured is an effect.
"""

GROUPS = {
    "grip of the floor": ("friction",),
    "grip of the front tyres": ("front.p_Dx1", "front.p_Dy1"),
    "grip of the rear tyres": ("rear.p_Dx1", "rear.p_Dy1"),
    "stiffness of the front tyres": ("front.p_Kx1", "front.p_Ky1"),
    "stiffness of the rear tyres": ("rear.p_Kx1", "rear.p_Ky1"),
    "yaw inertia": ("yaw_inertia",),
    "place of the centre of gravity": ("l_f",),
    "time constant of the steering": ("steering.time_constant",),
    "time constant of the drive": ("drive.time_constant",),
}
NUMBERS = tuple(name for names in GROUPS.values() for name in names)
