"""Recordings as their authors published them."""

import numpy as np
import pytest
import scipy.io

from conftest import measured_data
from riecjax.errors import DataError
from riecjax.records.recording import read_record


@pytest.mark.parametrize("number", [1, 2, 3, 4])
def test_closed_loop_propeller_arm(number):
    (path,) = measured_data("quarter_drone").glob(f"sinal{number}_*.csv")
    record = read_record(
        path, rename={"t": "Tempo_s", "y": "Saida_y", "u": "Controle_u"}, outliers="keep"
    )
    table = np.genfromtxt(path, delimiter=",", names=True)
    np.testing.assert_array_equal(record["y"], table["Saida_y"])
    np.testing.assert_array_equal(record["u"], table["Controle_u"])
    np.testing.assert_allclose(record.time_step, 0.01, rtol=1e-9)


def test_motor_driven_carriage():
    path = measured_data("emps") / "DATA_EMPS.mat"
    record = read_record(path, rename={"q": "qm"}, derive={"force": "35.15 * vir"})
    np.testing.assert_allclose(record["force"], 35.15 * scipy.io.loadmat(path)["vir"].ravel())
    assert record.sample_count == 24841
    np.testing.assert_allclose(record.time_step, 1e-3, rtol=1e-9)


@pytest.mark.parametrize("name", ["SNLS80mV", "Schroeder80mV"])
def test_silverbox_without_time(name):
    path = measured_data("silverbox") / f"{name}.mat"
    record = read_record(path, rename={"u": "V1", "y": "V2"}, time_step=2**14 / 1e7)
    np.testing.assert_array_equal(record["y"], scipy.io.loadmat(path)["V2"].ravel())
    assert record.sample_count == 131072
    assert float(record.time_step) == 2**14 / 1e7


@pytest.mark.parametrize(("number", "samples"), [(1, 3001), (2, 1501), (4, 1501)])
def test_magnetorheological_damper_by_the_columns_of_a_matrix(number, samples):
    path = measured_data("mr_damper_labcontrol") / f"data_simulation_4.{number}_MRdamper.mat"
    names = {"t": "tout", "x": "x_F[0]", "v": "x_F[1]", "F": "x_F[2]"}
    record = read_record(path, rename=names, scale={"x": 1e-3, "v": 1e-3})
    matrix = scipy.io.loadmat(path)["x_F"]
    np.testing.assert_allclose(record["x"], 1e-3 * matrix[:, 0])
    np.testing.assert_array_equal(record["F"], matrix[:, 2])
    assert record.sample_count == samples
    np.testing.assert_allclose(record.time_step, 0.01, rtol=1e-9)


def test_a_files_infinite_by_products_do_not_stand_in_the_way():
    path = measured_data("mr_damper_labcontrol") / "data_simulation_4.2_MRdamper.mat"
    assert np.isinf(scipy.io.loadmat(path)["theta_a"]).any()
    assert "theta_a" not in read_record(path, rename={"t": "tout", "F": "x_F[2]"}).arrays
    with pytest.raises(DataError, match="'angle' has 181 infinite"):
        read_record(path, rename={"t": "tout", "angle": "theta_a"})


def test_pendulum_in_cells():
    path = measured_data("pendulum_single") / "SinglePendulumDataForParameterEstimation.mat"
    for piece in (1, 2, 3, 4):
        names = {"t": f"Time_id{{{piece}}}", "theta": f"Y_id{{{piece}}}[0]"}
        record = read_record(path, rename=names, outliers="keep").select("theta")
        cell = scipy.io.loadmat(path)["Y_id"][piece - 1, 0]
        np.testing.assert_array_equal(record["theta"], cell[0])
        np.testing.assert_allclose(record.time_step, 1e-3, rtol=1e-6)


def test_pendulum_in_structures_with_time():
    path = measured_data("pendulum_single") / "SingleDataFreeSwing_1_Dt_0_0001.mat"
    record = read_record(path, rename={"theta": "Theta1.signals.values"})
    assert record.sample_count == 231757
    np.testing.assert_allclose(record.time_step, 1e-4, rtol=1e-6)
    np.testing.assert_allclose(record.start_time, 60.0)
