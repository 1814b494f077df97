"""The pool of packets that the simulated Teensy's receiver, queues and transmitter share."""
from __future__ import annotations

from car_interface.sim.teensy_packets import PACKET_SIZE, PacketPool


def test_packet_that_has_lain_free_for_longest_is_taken_first():
    pool = PacketPool(2, None)
    first, second = pool.acquire(), pool.acquire()
    pool.release(second)
    pool.release(first)
    assert pool.acquire() is second and pool.acquire() is first


def test_empty_pool_gives_none():
    pool = PacketPool(1, None)
    pool.acquire()
    assert pool.acquire() is None


def test_packet_comes_back_with_what_was_in_it():
    pool = PacketPool(1, None)
    packet = pool.acquire()
    packet[7] = 0x55
    pool.release(packet)
    assert pool.acquire()[7] == 0x55


def test_memory_is_zeros_or_the_garbage_of_its_seed():
    assert PacketPool(1, None).acquire() == bytes(PACKET_SIZE)
    assert PacketPool(1, 5).acquire() == PacketPool(1, 5).acquire() != PacketPool(1, 6).acquire()
