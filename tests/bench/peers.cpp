/* SPDX-License-Identifier: MIT */
// One sample of the normal equations, by zygos and by Pinocchio with Eigen: the same arm, the same states, as many
// parameters. Reads peers.bin: int32 joints and samples, the configuration, then doubles: per joint its frame in that
// of the body before (rotation row-major, origin) and its axis; per sample q, theta, their rates, omega. The argument
// is how often all samples are worked off. Prints nanoseconds a sample of both.
//
// Pinocchio gets its own part for nothing: the velocity of the base, which nobody measures, the columns of rotors,
// springs and dampers, and the reduction of its ten parameters a body to those that can be told apart. peer_eigen_own
// is the rank-1 update without that reduction: ten parameters a body, and three a joint.

#include "zygos/zygos.h"

#include <pinocchio/algorithm/regressor.hpp>
#include <pinocchio/multibody.hpp>

#include <chrono>
#include <cstdint>
#include <cstdio>
#include <cstring>
#include <fstream>
#include <vector>

namespace
{

// The kinds of joints that there are: compiling all of Pinocchio's takes minutes, and a choice among few is no slower.
template <typename Scalar, int options> struct Joints {
    template <int axis> using Model = pinocchio::JointModelRevoluteTpl<Scalar, options, axis>;
    template <int axis> using Data = pinocchio::JointDataRevoluteTpl<Scalar, options, axis>;
    using JointModelVariant =
        boost::variant<Model<0>, Model<1>, Model<2>, pinocchio::JointModelFreeFlyerTpl<Scalar, options>,
                       pinocchio::JointModelRevoluteUnalignedTpl<Scalar, options>>;
    using JointDataVariant =
        boost::variant<Data<0>, Data<1>, Data<2>, pinocchio::JointDataFreeFlyerTpl<Scalar, options>,
                       pinocchio::JointDataRevoluteUnalignedTpl<Scalar, options>>;
};
using Model = pinocchio::ModelTpl<double, 0, Joints>;
using Data = pinocchio::DataTpl<double, 0, Joints>;

zygos_arm_t arm;
std::vector<zygos_arm_state_t> states;
Model model;
std::vector<Eigen::VectorXd> positions, velocities;

// Normal equations, and the row that is added to them.
struct Sums {
    Eigen::MatrixXd gram;
    Eigen::VectorXd row;
    explicit Sums(Eigen::Index width) : gram(Eigen::MatrixXd::Zero(width, width)), row(Eigen::VectorXd::Ones(width))
    {
    }

    void add(const Data &data)
    {
        const Eigen::Index shared = std::min(row.size(), data.kineticEnergyRegressor.size());
        row.head(shared) = data.kineticEnergyRegressor.head(shared).transpose();
        gram.selfadjointView<Eigen::Lower>().rankUpdate(row);
    }
};

template <typename T> T read(std::ifstream &in)
{
    T value;
    in.read(reinterpret_cast<char *>(&value), sizeof value);
    return value;
}

Eigen::VectorXd read_vector(std::ifstream &in, int size)
{
    Eigen::VectorXd out(size);
    in.read(reinterpret_cast<char *>(out.data()), static_cast<std::streamsize>(sizeof(double)) * size);
    return out;
}

pinocchio::JointIndex add_joint(pinocchio::JointIndex parent, const Eigen::Vector3d &axis, const pinocchio::SE3 &place)
{
    // A joint along an axis of its frame has a cheaper model.
    if (axis == Eigen::Vector3d::UnitX()) {
        return model.addJoint(parent, pinocchio::JointModelRX(), place, "x" + std::to_string(parent));
    }
    if (axis == Eigen::Vector3d::UnitY()) {
        return model.addJoint(parent, pinocchio::JointModelRY(), place, "y" + std::to_string(parent));
    }
    if (axis == Eigen::Vector3d::UnitZ()) {
        return model.addJoint(parent, pinocchio::JointModelRZ(), place, "z" + std::to_string(parent));
    }
    return model.addJoint(parent, pinocchio::JointModelRevoluteUnaligned(axis), place, "u" + std::to_string(parent));
}

} // namespace

// Counted by name.
extern "C" {

__attribute__((noinline)) void peer_zygos_columns(const zygos_arm_state_t *state)
{
    zygos_kinematics(&arm.geometry, &arm.sums.config, state, &arm.motion);
}

__attribute__((noinline)) void peer_zygos_sums(const zygos_arm_state_t *state)
{
    if (zygos_balance_row(&arm.balance, &arm.sums.config, &arm.sums.column_map, &arm.noise.integral_bias, state,
                          &arm.motion, &arm.row)) {
        if (!zygos_accumulator_add(&arm.sums.energy, &arm.row, 1.0)) {
            zygos_accumulator_proceed(&arm.sums.energy);
        }
    }
}

__attribute__((noinline)) void peer_pinocchio(Data &data, const Eigen::VectorXd &q, const Eigen::VectorXd &v)
{
    pinocchio::computeKineticEnergyRegressor(model, data, q, v);
}

__attribute__((noinline)) void peer_eigen(Sums &sums, const Data &data)
{
    sums.add(data);
}

__attribute__((noinline)) void peer_eigen_own(Sums &sums, const Data &data)
{
    sums.add(data);
}
}

namespace
{

// Nanoseconds a sample.
double nanoseconds(auto &&one)
{
    const auto begin = std::chrono::steady_clock::now();
    for (std::size_t k = 0; k < states.size(); k++) {
        one(k);
    }
    const std::chrono::duration<double, std::nano> took = std::chrono::steady_clock::now() - begin;
    return took.count() / static_cast<double>(states.size());
}

} // namespace

int main(int count, char **argument)
{
    std::ifstream in("peers.bin", std::ios::binary);
    const int rounds = (count == 2) ? std::atoi(argument[1]) : 1;
    const auto joints = read<std::int32_t>(in);
    const auto samples = read<std::int32_t>(in);
    zygos_config_t config;
    in.read(reinterpret_cast<char *>(&config), sizeof config);
    config.abi = ZYGOS_ABI;
    if (!in || zygos_arm_init(&arm, &config) < 0) {
        return 1;
    }
    pinocchio::JointIndex carrier =
        model.addJoint(0, pinocchio::JointModelFreeFlyer(), pinocchio::SE3::Identity(), "base");
    for (int i = 0; i < joints; i++) {
        const Eigen::Matrix3d columns = Eigen::Map<Eigen::Matrix3d>(read_vector(in, 9).data());
        const Eigen::Vector3d origin = read_vector(in, 3);
        const Eigen::Vector3d axis = read_vector(in, 3);
        carrier = add_joint(carrier, axis, pinocchio::SE3(columns.transpose(), origin));
    }
    for (int k = 0; k < samples; k++) {
        zygos_arm_state_t state{};
        Eigen::VectorXd position(7 + joints), velocity(6 + joints);
        const Eigen::VectorXd q = read_vector(in, joints), theta = read_vector(in, joints);
        const Eigen::VectorXd q_rate = read_vector(in, joints), theta_rate = read_vector(in, joints);
        const Eigen::Vector3d omega = read_vector(in, 3);
        position << 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0, q;
        velocity << 0.1, 0.2, 0.3, omega, q_rate;
        for (int i = 0; i < joints; i++) {
            state.q[i] = q[i];
            state.theta[i] = theta[i];
            state.q_rate[i] = q_rate[i];
            state.theta_rate[i] = theta_rate[i];
        }
        std::memcpy(state.omega, omega.data(), sizeof state.omega);
        state.accepted = 1.0;
        states.push_back(state);
        positions.push_back(position);
        velocities.push_back(velocity);
    }
    if (!in) {
        return 1;
    }
    Data data(model);
    Sums sums(static_cast<Eigen::Index>(arm.sums.energy.width)), own(10 * (joints + 1) + 3 * joints + 2);
    // Turn about, so that both see the same machine; the fastest round of each counts.
    double ours = 1e99, theirs = 1e99;
    for (int round = 0; round < rounds; round++) {
        ours = std::min(ours, nanoseconds([](std::size_t k) {
                            peer_zygos_columns(&states[k]);
                            peer_zygos_sums(&states[k]);
                        }));
        theirs = std::min(theirs, nanoseconds([&](std::size_t k) {
                              peer_pinocchio(data, positions[k], velocities[k]);
                              peer_eigen(sums, data);
                          }));
        for (std::size_t k = 0; k < states.size(); k++) {
            peer_eigen_own(own, data);
        }
    }
    std::printf("%.17g %.17g %.17g\n", ours, theirs,
                sums.gram.trace() + own.gram.trace() + arm.sums.energy.buffer[0].gram[0]);
    return 0;
}
