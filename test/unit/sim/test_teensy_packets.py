"""The pool of packets that the simulated Teensy's receiver, queues and transmitter share."""
from __future__ import annotations

from car_interface.sim.teensy_packets import PACKET_SIZE, PacketPool


def test_packet_that_has_lain_free_for_longest_is_taken_first():
    pool = PacketPool(2, None)
    first, second = pool.take(), pool.take()
    pool.give(second)
    pool.give(first)
    assert pool.take() is second and pool.take() is first


def test_empty_pool_gives_none():
    pool = PacketPool(1, None)
    pool.take()
    assert pool.take() is None


def test_packet_comes_back_with_what_was_in_it():
    pool = PacketPool(1, None)
    packet = pool.take()
    packet[7] = 0x55
    pool.give(packet)
    assert pool.take()[7] == 0x55


def test_memory_is_zeros_or_the_garbage_of_its_seed():
    assert PacketPool(1, None).take() == bytes(PACKET_SIZE)
    assert PacketPool(1, 5).take() == PacketPool(1, 5).take() != PacketPool(1, 6).take()
