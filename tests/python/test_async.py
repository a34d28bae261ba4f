"""AsyncClient: the results of Client, many at once, and what it leaves behind."""

import asyncio
import os

import numpy as np
import pytest
from running import serving
from shapes import box_cage, box_vertices, points_inside
from test_resume import bits

from barycast import AsyncClient, Client, InputError, ServerError

CALLS = 50


def inputs(call):
    return box_cage(), points_inside(200 + call, seed=call)


@pytest.mark.parametrize("flags", [("--requests-max", 64), ("--requests-max", 2)], ids=["roomy", "busy"])
def test_many_binds_at_once(real_daemon, flags):
    """The busy server refuses most of them at first, with a delay after which they come again."""
    options = dict(gradients=True, samples=20)
    with serving(real_daemon, "--threads", 2, *flags) as port:

        async def run():
            async with AsyncClient(f"127.0.0.1:{port}", retry_seconds=120) as client:
                return await asyncio.gather(*[client.bind(*inputs(call), **options) for call in range(CALLS)])

        together = asyncio.run(run())
        with Client(f"127.0.0.1:{port}") as client:
            for call, binding in enumerate(together):
                assert bits(binding) == bits(client.bind(*inputs(call), **options))


def test_busy_answers_are_final_without_a_budget(real_daemon):
    with serving(real_daemon, "--threads", 1, "--requests-max", 1) as port:

        async def run():
            async with AsyncClient(f"127.0.0.1:{port}", retry_seconds=0) as client:
                await client.upload(box_cage())
                calls = [client.bind(box_cage(), points_inside(3000), samples=300) for _ in range(4)]
                return await asyncio.gather(*calls, return_exceptions=True)

        outcomes = asyncio.run(run())
    errors = [outcome for outcome in outcomes if isinstance(outcome, Exception)]
    assert errors and len(errors) < 4
    assert all(error.code == "RESOURCE_EXHAUSTED" and error.retry_seconds > 0 for error in errors)


def test_the_verbs(daemon):
    async def run():
        async with AsyncClient(threads=1) as client:
            assert (await client.capabilities()).numerics_version >= 1
            assert (await client.upload(box_cage())).digest.sha256 == box_cage().digest.sha256
            binding = await client.bind(box_cage(), points_inside(50), dtype="float64")
            np.testing.assert_allclose(binding.deform(box_vertices() * 2), points_inside(50) * 2, atol=1e-11)
            with pytest.raises(InputError) as caught:
                await client.bind(box_cage(), points_inside(3), samples=0 if "fake" not in daemon.name else 200000)
            assert caught.value.field.endswith("samples")
            async for rows in client.compute(box_cage(), points_inside(5000)):
                break  # leaves the rest
            pid = client.connection.local.pid
        await client.close()  # again, harmless
        return pid

    pid = asyncio.run(run())
    assert not os.path.exists(f"/proc/{pid}")


def test_a_private_server_that_died_is_replaced_once(real_daemon):
    async def run():
        async with AsyncClient(threads=1) as client:
            await client.bind(box_cage(), points_inside(5))
            first = client.connection.local.pid
            os.kill(first, 9)
            bindings = await asyncio.gather(*[client.bind(*inputs(call)) for call in range(8)])
            assert [binding.matrix.shape[0] for binding in bindings] == [200 + call for call in range(8)]
            assert client.connection.local.pid != first

    asyncio.run(run())


def test_cancelling_a_task_cancels_the_call(fake, behaviour):
    behaviour.row_seconds = 5.0

    async def run():
        async with AsyncClient(fake.address) as client:
            with pytest.raises(asyncio.TimeoutError):
                await asyncio.wait_for(client.bind(box_cage(), points_inside(3000)), 0.3)

    asyncio.run(run())


def test_deadline(fake, behaviour):
    behaviour.row_seconds = 1.0

    async def run():
        async with AsyncClient(fake.address, timeout_seconds=0.2) as client:
            await client.bind(box_cage(), points_inside(3))

    with pytest.raises(ServerError) as caught:
        asyncio.run(run())
    assert caught.value.code == "DEADLINE_EXCEEDED"


def test_many_calls_start_one_private_server(fake_daemon):
    async def run():
        async with AsyncClient() as client:
            await asyncio.gather(*[client.capabilities() for _ in range(10)])

    asyncio.run(run())


