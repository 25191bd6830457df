"""The numbers that a user configures and may have wrong, in the user's words.

Mass is weighed, and motion shows only ratios to it; more drag than configured is an effect.
"""

NUMBERS = {
    "friction": "grip of the floor",
    "front.p_Dx1": "grip of the front tyres lengthways",
    "front.p_Dy1": "grip of the front tyres sideways",
    "rear.p_Dx1": "grip of the rear tyres lengthways",
    "rear.p_Dy1": "grip of the rear tyres sideways",
    "front.p_Kx1": "stiffness of the front tyres lengthways",
    "front.p_Ky1": "stiffness of the front tyres sideways",
    "rear.p_Kx1": "stiffness of the rear tyres lengthways",
    "rear.p_Ky1": "stiffness of the rear tyres sideways",
    "yaw_inertia": "yaw inertia",
    "l_f": "place of the centre of gravity, from the front axle",
    "steering.time_constant": "time constant of the steering",
    "drive.time_constant": "time constant of the drive",
}
