"""A Go2 in a process of its own, made of the vendor's definitions alone: low-level state out, commands in.

    python go2_stand_in.py DOMAIN CYCLONEDDS_XML [--no-switcher | --stubborn]

Twelve motors of unit inertia follow the commands; the angle of motor i at the start is 0.01 (i + 1). A line on stdin
is an order; every order is answered with a line of JSON:
    report          what has been received
    freeze          the last state again and again
    mute            no state any more
    nan             the angle of motor 3 is not a number
    work            motor 2 turns with 3 rad/s against 4 N m, motor 5 is turned back by 6 N m; no other moves
    buttons         L2 and B of the remote control are held
    quit
"""

import json
import select
import sys
import time

from cyclonedds.domain import Domain, DomainParticipant
from cyclonedds.pub import DataWriter
from cyclonedds.sub import DataReader
from cyclonedds.topic import Topic
from unitree_sdk2py.idl.default import unitree_go_msg_dds__LowState_
from unitree_sdk2py.idl.unitree_api.msg.dds_ import Request_, Response_, ResponseHeader_, ResponseStatus_
from unitree_sdk2py.idl.unitree_go.msg.dds_ import LowCmd_, LowState_
from unitree_sdk2py.utils.crc import CRC

PERIOD = 0.004


class Switcher:
    """The service that says which of the robot's own programs walks, and ends it."""

    def __init__(self, participant, stubborn, mumbling):
        self.active, self.stubborn, self.mumbling = "ai", stubborn, mumbling
        self.requests = DataReader(participant, Topic(participant, "rt/api/motion_switcher/request", Request_))
        self.responses = DataWriter(participant, Topic(participant, "rt/api/motion_switcher/response", Response_))

    def serve(self):
        for request in self.requests.take(8):
            if not isinstance(request, Request_):  # the word that a client has left
                continue
            identity = request.header.identity
            if identity.api_id == 1003 and not self.stubborn:
                self.active = ""
            data = json.dumps({"form": "0", "name": self.active}) if identity.api_id == 1001 else ""
            data = data.replace("name", "mode") if self.mumbling else data
            self.responses.write(Response_(ResponseHeader_(identity, ResponseStatus_(0)), data, []))


def main():
    domain, xml, *options = sys.argv[1:]
    kept = Domain(int(domain), xml)
    participant = DomainParticipant(int(domain))
    switcher = (
        None if "--no-switcher" in options else Switcher(participant, "--stubborn" in options, "--mumbling" in options)
    )
    commands = DataReader(participant, Topic(participant, "rt/lowcmd", LowCmd_))
    states = DataWriter(participant, Topic(participant, "rt/lowstate", LowState_))
    crc, state = CRC(), unitree_go_msg_dds__LowState_()
    state.imu_state.quaternion = [1.0, 0.0, 0.0, 0.0]
    state.imu_state.gyroscope = [0.1, 0.2, 0.3]
    state.imu_state.accelerometer = [0.0, 0.5, 9.8]
    state.foot_force = [50, 0, 21, 20]
    state.power_v, state.power_a = 29.5, 1.25
    for i in range(12):
        state.motor_state[i].q = 0.01 * (i + 1)
        state.motor_state[i].tau_est = 0.5 * i
    last, received, wrong, mode = None, 0, 0, "normal"
    begin = time.monotonic()
    print(json.dumps({"ready": kept is not None}), flush=True)
    while True:
        if mode == "restart":
            begin, mode = time.monotonic(), "normal"
        if mode != "freeze":
            state.tick = int((time.monotonic() - begin) * 1000) + 1
        if mode == "nan":
            state.motor_state[3].q = float("nan")
        if mode == "buttons":
            state.wireless_remote[2], state.wireless_remote[3] = 0b00100000, 0b00000010
        if mode != "mute":
            states.write(state)
        for command in commands.take(8):
            if not isinstance(command, LowCmd_):
                continue
            received += 1
            wrong += command.crc != crc.Crc(command)
            last = command
        if mode == "work":
            for i in range(12):
                state.motor_state[i].dq, state.motor_state[i].tau_est = {2: (3.0, 4.0), 5: (-2.0, 6.0)}.get(
                    i, (0.0, 0.0)
                )
        elif last is not None:
            for motor, order in zip(state.motor_state[:12], last.motor_cmd, strict=False):
                torque = order.kp * (order.q - motor.q) + order.kd * (order.dq - motor.dq) + order.tau
                motor.dq += torque * PERIOD
                motor.q += motor.dq * PERIOD
        if switcher:
            switcher.serve()
        if select.select([sys.stdin], [], [], PERIOD)[0]:
            order = sys.stdin.readline().strip()
            mode = mode if order == "report" else order
            print(
                json.dumps(
                    {
                        "received": received,
                        "wrong_crc": wrong,
                        "active": switcher.active if switcher else None,
                        "head": last and [*last.head, last.level_flag],
                        "motors": last and [[m.mode, m.q, m.dq, m.tau, m.kp, m.kd] for m in last.motor_cmd],
                    }
                ),
                flush=True,
            )
            if order in ("quit", ""):
                return


if __name__ == "__main__":
    main()
