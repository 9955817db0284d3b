import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from recordings_helpers import LENGTHS, sequences

from jaxreplay import Records
from jaxreplay.plane.params import PlaneParams
from jaxreplay.plane.positions import DEMONSTRATED
from jaxreplay.recordings.inspect import inspect
from jaxreplay.recordings.report import report
from jaxreplay.study.demonstrations import record


def findings(sensors, commands):
    found = inspect(Records.from_sequences(sensors, commands)).findings
    return [(f.text, f.records, f.column, f.at) for f in found]


@settings(max_examples=40)
@given(
    st.lists(st.integers(90, 110), min_size=1, max_size=8),
    st.integers(0, 2**32 - 1),
    st.sampled_from([1e-3, 1.0, 1e3]),
)
def test_ordinary_records_are_not_suspected(lengths, seed, scale):
    assert findings(*sequences(lengths, seed, scale)) == []


def test_nor_are_the_planes_however_few():
    records = record(PlaneParams(), DEMONSTRATED[:5], 1)
    for which in ([0], [1], [2, 3], range(3), range(5)):
        assert inspect(records.subset(which)).findings == []


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_nor_are_all_of_the_planes(seed):
    assert inspect(record(PlaneParams(), DEMONSTRATED, seed)).findings == []


@given(st.data())
def test_the_table_is_as_counted_row_by_row(data):
    value = st.integers(-3, 3)
    lengths = data.draw(st.lists(st.integers(1, 6), min_size=1, max_size=4))
    z = [data.draw(st.lists(value, min_size=n, max_size=n)) for n in lengths]
    u = [data.draw(st.lists(value, min_size=n, max_size=n)) for n in lengths]
    records = Records.from_sequences(*([np.array(x)[:, None] for x in xs] for xs in (z, u)))
    inspection = inspect(records)
    assert inspection.lengths.tolist() == lengths
    for column, xs in zip(inspection.columns, (z, u), strict=True):
        flat = sorted(x for one in xs for x in one)
        middle = (flat[(len(flat) - 1) // 2] + flat[len(flat) // 2]) / 2
        assert (column.lowest, column.median, column.highest) == (flat[0], middle, flat[-1])
        steps = {
            (i, t): abs(one[t] - one[t - 1]) for i, one in enumerate(xs) for t in range(1, len(one))
        }
        if not steps:
            assert np.isnan([column.step, column.largest, column.unchanged]).all()
            assert column.at is None
            continue
        sizes = list(steps.values())
        assert column.step == np.median(sizes)
        assert column.largest == max(sizes)
        assert column.unchanged == pytest.approx(sizes.count(0) / len(sizes))
        first = min((at for at, size in steps.items() if size == max(sizes)), default=None)
        assert column.at == (first if max(sizes) else None)


@pytest.mark.parametrize("n", [1, 2, 6])
@pytest.mark.parametrize("rows", [1, 2])
@pytest.mark.parametrize("sensor", [0, 1, 2])
def test_a_spike_is_found_even_in_one_record(n, rows, sensor):
    sensors, commands = sequences(LENGTHS[:n])
    i = n - 1
    sensors[i][10 : 10 + rows, sensor] += 40
    ((text, which, column, at),) = findings(sensors, commands)
    assert (which, column, at) == ((i,), sensor, (i, 10))
    assert text.startswith(f"sensor z{sensor} has a spike of")
    assert f"record {i}, row 10" in text


def test_a_jump_that_stays_is_found_and_the_worst_is_named():
    sensors, commands = sequences()
    sensors[4][40:, 0] += 5
    sensors[1][50:, 0] += 3
    ((text, which, column, at),) = findings(sensors, commands)
    assert (which, column, at) == ((1, 4), 0, (4, 40))
    assert "jumps by" in text
    assert "record 4, row 40 (1 more; records 1, 4)" in text


@pytest.mark.parametrize("n", [1, 6])
def test_a_stuck_sensor_is_found(n):
    sensors, commands = sequences(LENGTHS[:n])
    sensors[0][30:90, 1] = sensors[0][30, 1] = 0.123
    ((text, which, column, at),) = findings(sensors, commands)
    assert (which, column, at) == ((0,), 1, (0, 30))
    assert "stays at 0.123 for 60 rows from record 0, row 30" in text


def test_one_out_of_sight_for_most_of_the_only_record_is_not_stuck():
    sensors, commands = sequences([400])
    sensors[0][:, 2] = np.where(np.arange(400) < 300, 0, sensors[0][150, 2] + sensors[0][:, 1] ** 2)
    assert findings(sensors, commands) == []


def test_lengths_far_off_are_found():
    assert findings(*sequences((100, 110, 95, 50, 98, 240)))[0][1] == (3, 5)
    assert findings(*sequences((100,) * 5 + (130,)))[0][1] == (5,)
    assert findings(*sequences((100,) * 5 + (120,))) == []
    assert findings(*sequences((100, 200, 150, 250, 300, 50))) == []


def test_records_shorter_than_the_end_are_found():
    ((text, which, *_),) = findings(*sequences((100, 9, 95, 1, 98)))
    assert which == (1, 3)
    assert text.startswith("records 1 (9 rows), 3 (1 row): fewer than the 10 rows")
    assert findings(*sequences((10, 10, 10))) == []


def test_copies_are_found_whole_and_cut():
    sensors, commands = sequences()
    for rows in (sensors, commands):
        rows.append(rows[2].copy())
        rows.append(rows[2][:80].copy())
        rows.append(rows[4][5:85].copy())
    (cut, (text, which, *_)) = findings(sensors, commands)
    assert cut[1] == (7, 8)  # in motion at their end
    assert which == (2, 6, 7)
    assert text.startswith("records 6, 7 (80 rows): the same as record 2")
    sensors[6][50, 0] += 0.01
    assert findings(sensors, commands)[1][1] == (2, 7)


def test_what_never_changes_is_found():
    sensors, commands = sequences()
    for i, (z, u) in enumerate(zip(sensors, commands, strict=True)):
        z[:, 0] = 7
        u[:, 0] = i
    sensors[3][:, 1] = 0.5
    found = findings(sensors, commands)
    assert [f[1:3] for f in found] == [((), 0), ((3,), 1)]
    assert found[0][0].startswith("sensor z0 is 7 in every row")
    assert found[1][0].startswith("sensor z1 never changes in record 3 (0.5), but does in 5 others")
    for u in commands:
        u[:, 0] = 2
    assert findings(sensors, commands)[2][0].startswith("command u0 is 2 in every row")


def test_a_few_bad_records_do_not_hide_each_other():
    sensors, commands = sequences((100,) * 12)
    for i in range(5):
        sensors[i][60, 0] += 1000.0**i
    ((_, which, *_),) = findings(sensors, commands)
    assert which == (0, 1, 2, 3, 4)


def test_the_report_has_seconds_only_where_the_period_is_known():
    sensors, commands = sequences((100, 120, 90))
    text = report(inspect(Records.from_sequences(sensors, commands, period=0.1)))
    assert "3 records, a row every 0.1 s; 310 rows (31 s) in all" in text
    assert "shortest: record 2, 90 rows (9 s); median: 100 rows (10 s); longest: record 1" in text
    assert text.endswith("Worth a look:\n  nothing unusual found")
    text = report(inspect(Records.from_sequences(sensors, commands)))
    assert "3 records, period unknown; 310 rows in all" in text
    assert "shortest: record 2, 90 rows; median: 100 rows; longest: record 1, 120 rows" in text
