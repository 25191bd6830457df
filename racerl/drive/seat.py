"""The driver's seat: hands, car, clock, log and window, one control step after the other."""

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from racerl.drive.controls import requests
from racerl.drive.hands import Hands, Hold, Request, clip
from racerl.drive.pedals import Pedal
from racerl.drive.screen import Picture, Screen
from racerl.drive.session import Phase, Session
from racerl.drive.world import put
from racerl.env.race import DELTA, OMEGA, V_X, V_Y, YAW, Race, X, Y
from racerl.evaluate.drive import Recorder
from racerl.evaluate.laps import Lap
from racerl.vehicle.ops import TORCH


@dataclass
class Seat:
    """The driver's seat: everything that a control step, and its picture, is made of. It is the race's controller."""

    race: Race
    session: Session
    hands: Hands
    pedal: Pedal
    screen: Screen
    recorder: Recorder
    held: Hold = Hold(0.0, 0.0)  # what the hands do
    put_back: bool = False  # the driver asks for it
    over: bool = False

    @property
    def name(self) -> str:
        """What reports call the controller."""
        return self.hands.name

    def act(self, race: Race) -> Tensor:
        """Return the action (1, 2) in [−1, 1] that the hands mean."""
        omega = float(race.seen()[0][OMEGA])
        return torch.tensor([[self.held.steering, clip(self.pedal.drive(self.held.pedal, omega))]])

    def drive(self) -> None:
        """Drive until the driver leaves."""
        while not self.over:
            events = self.screen.events()
            for request in (*requests(events), *self.hands.take(events)):
                self.grant(request)
            self.held = self.hands.hold()
            if self.session.moves(self.held.pedal):
                self.step()
            self.screen.draw(self.picture())
            if self.hands.live:
                self.screen.wait(self.race.timing.dt)
        self.close()

    def leave(self) -> None:
        """Let the control step under way be the last."""
        self.over = True

    def close(self) -> None:
        """Add the sample at which the drive ended, so that the log holds the last crossing of the line."""
        if self.recorder.time[0] > 0.0:  # the run has begun
            last = self.recorder.steps[-1]["manoeuvre"]
            row = {**self.recorder.before(), "lap": np.array([self.session.lap]), "manoeuvre": last}
            self.recorder.after(row, self.race.command, np.array([False]))

    def grant(self, request: Request) -> None:
        """Do what the driver asks for, where it makes sense now."""
        session = self.session
        if request is Request.QUIT or (request is Request.START and session.phase is Phase.FINISHED):
            self.leave()
        elif request is Request.START and session.phase is Phase.PRACTICE:
            session.count(float(self.race.travelled))
            self.put_back = False  # asked for before the session, it would cost its first lap
            self.recorder.cut(np.array([bool(self.recorder.steps)]))
        elif request is Request.PAUSE:
            session.paused = not session.paused
        elif request is Request.PUT_BACK:
            self.put_back = not session.standing
        elif request in (Request.MORE, Request.LESS):
            self.pedal.adjust(1 if request is Request.MORE else -1)

    def step(self) -> None:
        """Drive one control step; after a crash, or when it is asked for, put the car back where it left."""
        race, session = self.race, self.session
        row = {**self.recorder.before(), "lap": np.array([session.lap]), "manoeuvre": np.array([session.phase.value])}
        before, s = float(race.travelled), race.s
        step = race.step(self.act(race))
        after = before + float(step.progress)
        ended = bool(step.terminated) or self.put_back
        if ended:
            put(race, s)
        session.update(before, after, float(step.margin), ended, float(race.travelled))
        self.recorder.after(row, step.command, np.array([ended]))
        self.put_back = False

    def picture(self) -> Picture:
        """Return what is to be seen now: the car as its sensors show it."""
        state, session, vehicle = self.race.seen()[0], self.session, self.race.vehicle
        slips = vehicle.slips(vehicle.motion(list(state)), TORCH)
        kappa_f, alpha_f, kappa_r, alpha_r = (float(slip) for slip in slips)
        return Picture(
            x=float(state[X]),
            y=float(state[Y]),
            yaw=float(state[YAW]),
            speed=float(torch.hypot(state[V_X], state[V_Y])),
            omega=float(state[OMEGA]),
            delta=float(state[DELTA]),
            slips=((kappa_f, alpha_f), (kappa_r, alpha_r)),
            hold=self.held,
            mode=self.pedal.text,
            title=title(session),
            elapsed=session.elapsed,
            delta_to_best=session.delta,
            last=lap_text(session.last),
            best=lap_text(session.best),
            message=message(session),
            gamepad=self.hands.name == "gamepad",
        )


def title(session: Session) -> str:
    """Return what is being driven."""
    if session.phase is Phase.COUNTED:
        return f"lap {len(session.driven) + 1} of {session.laps}"
    return session.phase.value


def lap_text(lap: Lap | None) -> str:
    """Return a lap's time and what it was worth."""
    if lap is None:
        return "–"
    if lap.time_s is None:
        return "crashed"
    return f"{lap.time_s:.3f} s" + ("" if lap.valid else ", off track")


def message(session: Session) -> str:
    """Return what the driver should know or do."""
    if session.phase is Phase.FINISHED:
        clean = sum(lap.valid for lap in session.counted)
        return f"{len(session.counted)} laps driven, {clean} of them clean: Enter (A) ends"
    if session.paused:
        return "paused"
    if session.standing:
        return "throttle to drive off"
    if session.phase is Phase.COUNTED and session.elapsed is None:
        return "the next lap begins at the line"
    return ""
