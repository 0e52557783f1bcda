# SPDX-License-Identifier: MIT
def test_three_lost_frames(plant, dut, faults):
    stream = plant.run(400).through(faults.drop(joint=2, cycles=range(100, 103)))
    dut.start()
    plant.send(stream)
    dut.judge(stream, incomplete=3, dropped=3)
