// Runs the threads of a Warp kernel on the CPU as a GPU may: in warps of 32 lanes, both in random order, where lanes
// wait for each other whenever they add up. A lane is a stack of its own. Included by `tests.device.lanes` alone.
#pragma once

#include <algorithm>
#include <functional>
#include <numeric>
#include <random>
#include <ucontext.h>
#include <vector>

namespace lanes {

constexpr int LANES = 32;
constexpr size_t STACK = 1 << 16;  // bytes; kernels hold no arrays

struct Lane {
    ucontext_t context;
    std::vector<char> stack = std::vector<char>(STACK);
    bool ended, waiting;
    int operation;  // that it waits for
    float value;
    size_t task;
};

struct Machine {
    Lane lane[LANES];
    ucontext_t scheduler;
    int running = 0;
    float sums[LANES];
    bool any = false, diverged = false;
    const std::function<void(size_t)>* kernel = nullptr;
    std::mt19937 random { 1 };
};

static Machine machine;

static void begin() {
    Lane& lane = machine.lane[machine.running];
    (*machine.kernel)(lane.task);
    lane.ended = true;  // and on to the scheduler
}

static void wait(int operation, float value) {
    Lane& lane = machine.lane[machine.running];
    lane.operation = operation, lane.value = value, lane.waiting = true;
    swapcontext(&lane.context, &machine.scheduler);
}

static float sum(float value) {
    wait(1, value);
    return machine.sums[machine.running];
}

static bool any(bool flag) {
    wait(2, flag);
    return machine.any;
}

static bool is_first() { return machine.running == 0; }

// What __shfl_down_sync leaves in each lane after five rounds.
static void meet() {
    machine.any = false;
    for (int i = 0; i < LANES; i++) {
        machine.sums[i] = machine.lane[i].value;
        machine.any |= machine.lane[i].value != 0;
        machine.lane[i].waiting = false;
    }
    for (int k = LANES / 2; k > 0; k /= 2)
        for (int i = 0; i < LANES; i++) machine.sums[i] += machine.sums[i + k < LANES ? i + k : i];
}

static void run_warp(size_t first, size_t tasks) {
    for (int i = 0; i < LANES; i++) {
        Lane& lane = machine.lane[i];
        lane.task = first + i, lane.ended = lane.task >= tasks, lane.waiting = false;
        getcontext(&lane.context);
        lane.context.uc_stack.ss_sp = lane.stack.data(), lane.context.uc_stack.ss_size = STACK;
        lane.context.uc_link = &machine.scheduler;
        makecontext(&lane.context, begin, 0);
    }
    int order[LANES];
    std::iota(order, order + LANES, 0);
    for (int waiting = LANES; waiting == LANES;) {
        std::shuffle(order, order + LANES, machine.random);
        for (int i : order) {
            machine.running = i;
            if (!machine.lane[i].ended) swapcontext(&machine.scheduler, &machine.lane[i].context);
        }
        waiting = 0;
        for (Lane& lane : machine.lane) waiting += lane.waiting && lane.operation == machine.lane[0].operation;
        for (Lane& lane : machine.lane) machine.diverged |= lane.waiting && waiting < LANES;
        if (waiting == LANES) meet();
    }
}

static void run(size_t tasks, const std::function<void(size_t)>& kernel) {
    machine.kernel = &kernel;
    std::vector<size_t> warps((tasks + LANES - 1) / LANES);
    std::iota(warps.begin(), warps.end(), 0);
    std::shuffle(warps.begin(), warps.end(), machine.random);
    for (size_t warp : warps) run_warp(warp * LANES, tasks);
}

}  // namespace lanes

extern "C" bool lanes_diverged() { return lanes::machine.diverged; }
