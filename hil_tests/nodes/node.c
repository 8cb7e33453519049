/* Small nodes with CAN by FMI-LS-BUS 1.0 for tests: good ones and bad ones, chosen by a parameter. */

#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

enum { OK = 0, ERROR = 3, UNKNOWN = 0, UNCHANGED = 1, CHANGED = 2 };
enum { RX = 1, RX_CLOCK, TX, TX_CLOCK, NOTIFICATIONS, KIND, IDENTIFIER, PERIOD_US, BIT_RATE, DISCARD };
enum kind {
    SENDER,    /* sends a frame in each period */
    ECHO,      /* answers each frame at once, with the next identifier */
    CONFINED,  /* like SENDER, and counts errors and reports its state */
    STUBBORN,  /* like SENDER, and sends a frame again at once that lost arbitration */
    WAKER,     /* sends a wakeup in each period */
    SLEEPER,   /* sends a frame after a wakeup */
    GARBLER,   /* sends operations that are none */
    BURSTER,   /* sends 300 frames in each period */
    TICKER,    /* ticks without end at one instant */
    CREEPER,   /* ticks every 100 ns */
    TALKER,    /* sends 80,000 bytes at one instant */
    HANGER,    /* never returns from a step */
    CRASHER,   /* ends its process */
    QUITTER,   /* ends the simulation */
    LAGGARD,   /* returns early from a step */
};
enum { TRANSMIT = 0x10, CONFIRM = 0x20, LOST = 0x30, BUS_ERROR = 0x31, CONFIGURE = 0x40, STATUS = 0x41, WAKEUP = 0x42 };
enum { ACTIVE = 1, PASSIVE = 2, OFF = 3, RECOVERY_BITS = 1408 };
#define NS_PER_S 1000000000LL
#define NEVER INT64_MAX

typedef struct {
    int kind, identifier, period_us, bit_rate, discard, notified, triggered;
    int64_t now_ns, due_ns, next_ns, back_ns;
    int changed, ticked, active, tec, rec, status;
    uint8_t count;
    size_t length;
    uint8_t sent[100000];
} Node;

static void number(uint8_t *at, uint32_t value, int bytes) {
    for (int index = 0; index < bytes; index++) at[index] = (uint8_t)(value >> (8 * index));
}

static uint32_t value_of(const uint8_t *at) {
    return at[0] | (uint32_t)at[1] << 8 | (uint32_t)at[2] << 16 | (uint32_t)at[3] << 24;
}

static void send_operation(Node *node, uint32_t code, const void *content, size_t length) {
    uint8_t *at = node->sent + node->length;
    number(at, code, 4);
    number(at + 4, (uint32_t)(8 + length), 4);
    if (length > 0) memcpy(at + 8, content, length);
    node->length += 8 + length;
}

static void send_frame(Node *node, uint32_t identifier, const uint8_t *data, size_t length) {
    uint8_t content[16] = {0};
    number(content, identifier, 4);
    number(content + 6, (uint32_t)length, 2);
    memcpy(content + 8, data, length);
    send_operation(node, TRANSMIT, content, 8 + length);
}

static void report(Node *node) {
    int status = node->tec > 255 ? OFF : node->tec > 127 || node->rec > 127 ? PASSIVE : ACTIVE;
    if (status == node->status) return;
    uint8_t content = (uint8_t)(node->status = status);
    if (status == OFF) node->back_ns = node->now_ns + RECOVERY_BITS * NS_PER_S / node->bit_rate;
    send_operation(node, STATUS, &content, 1);
}

static void garble(Node *node) {
    static const uint8_t fd[9] = {1, 0, 0, 0}, extended[9] = {1, 0, 0, 0, 1, 0, 0, 0};
    static const uint8_t short_head[4] = {0x10, 0, 0, 0};
    uint8_t nine[17] = {1, 0, 0, 0, 0, 0, 9, 0};
    switch (node->count % 6) {
    case 0: send_operation(node, 0x99, "", 0); break;
    case 1: send_operation(node, 0x11, fd, sizeof fd); break;
    case 2: send_operation(node, TRANSMIT, extended, 8); break;
    case 3: send_operation(node, TRANSMIT, nine, sizeof nine); break;
    case 4: send_operation(node, STATUS, "\x07", 1); break;
    default:
        memcpy(node->sent + node->length, short_head, sizeof short_head);
        node->length += sizeof short_head;
    }
    node->count++;
}

/* Do what is due, and plan the next time. */
static void act(Node *node) {
    if (node->now_ns >= node->back_ns) {
        node->tec = node->rec = 0;
        node->back_ns = NEVER;
        report(node);
    }
    if (node->now_ns < node->next_ns) return;
    node->next_ns += node->period_us * 1000LL;
    if (node->kind == WAKER) send_operation(node, WAKEUP, "", 0);
    else if (node->kind == GARBLER) garble(node);
    else if (node->kind == CREEPER) node->next_ns = node->now_ns + 100;
    else if (node->kind == TICKER) node->next_ns = node->now_ns;
    else if (node->kind == CRASHER) abort();
    else if (node->kind != ECHO && node->kind != SLEEPER && node->kind != QUITTER && node->kind != LAGGARD && node->status != OFF) {
        int frames = node->kind == BURSTER ? 300 : node->kind == TALKER ? 5000 : 1;
        node->count++;
        while (frames-- > 0) send_frame(node, (uint32_t)node->identifier, &node->count, 1);
    }
}

static void plan(Node *node) {
    node->due_ns = node->next_ns < node->back_ns ? node->next_ns : node->back_ns;
    if (node->length > 0) node->due_ns = node->now_ns;
    node->changed = 1;
}

static void receive(Node *node, const uint8_t *at) {
    uint32_t code = value_of(at), identifier = value_of(at + 8);
    if (code == TRANSMIT && node->kind == ECHO) send_frame(node, identifier + 1, at + 16, at[14]);
    if (code == WAKEUP && node->kind == SLEEPER) send_frame(node, (uint32_t)node->identifier, at, 0);
    if (code == LOST && node->kind == STUBBORN) send_frame(node, identifier, &node->count, 1);
    if (node->kind != CONFINED) return;
    if (code == TRANSMIT && node->rec > 0) node->rec--;
    if (code == CONFIRM && node->tec > 0) node->tec--;
    if (code == BUS_ERROR && at[14]) node->tec += 8;
    if (code == BUS_ERROR && !at[14]) node->rec += at[13] == 1 ? 8 : 1;
    report(node);
}

const char *fmi3GetVersion(void) { return "3.0"; }

void *fmi3InstantiateCoSimulation(const char *name, const char *token, const char *resources, _Bool visible,
                                  _Bool logging, _Bool events, _Bool early, const uint32_t *between,
                                  size_t count, void *environment, void *log, void *update) {
    Node *node = events ? calloc(1, sizeof(Node)) : NULL;
    if (node == NULL) return NULL;
    node->identifier = 0x100;
    node->period_us = 10000;
    node->triggered = token[0] == 't';
    node->status = ACTIVE;
    node->back_ns = NEVER;
    return node;
}
void *fmi3InstantiateModelExchange(void) { return NULL; }
void *fmi3InstantiateScheduledExecution(void) { return NULL; }
void fmi3FreeInstance(void *instance) { free(instance); }
int fmi3SetDebugLogging(void) { return OK; }
int fmi3EnterInitializationMode(void) { return OK; }
int fmi3EnterEventMode(void) { return OK; }
int fmi3EnterStepMode(void) { return OK; }
int fmi3Terminate(void) { return OK; }

int fmi3ExitInitializationMode(void *instance) {
    Node *node = instance;
    uint8_t content[5] = {1};
    if (node->bit_rate > 0) {
        number(content + 1, (uint32_t)node->bit_rate, 4);
        send_operation(node, CONFIGURE, content, 5);
    } else {
        node->bit_rate = 250000;
    }
    if (node->discard) send_operation(node, CONFIGURE, "\x04\x02", 2);
    node->next_ns = node->period_us * 1000LL;
    plan(node);
    node->active = node->length > 0;
    return OK;
}

int fmi3SetInt32(void *instance, const uint32_t *references, size_t count, const int32_t *values, size_t total) {
    Node *node = instance;
    for (size_t index = 0; index < count; index++) {
        int *const places[] = {&node->kind, &node->identifier, &node->period_us, &node->bit_rate, &node->discard};
        if (references[index] < KIND || references[index] > DISCARD) return ERROR;
        *places[references[index] - KIND] = values[index];
    }
    return OK;
}

int fmi3SetBoolean(void *instance, const uint32_t *references, size_t count, const _Bool *values, size_t total) {
    if (count != 1 || references[0] != NOTIFICATIONS) return ERROR;
    ((Node *)instance)->notified = values[0];
    return OK;
}

int fmi3SetClock(void *instance, const uint32_t *references, size_t count, const _Bool *values) {
    Node *node = instance;
    if (references[0] == TX_CLOCK && values[0]) {
        act(node);
        node->ticked = 1;
    }
    return OK;
}

int fmi3GetClock(void *instance, const uint32_t *references, size_t count, _Bool *values) {
    Node *node = instance;
    values[0] = node->active;
    node->active = 0;
    return OK;
}

int fmi3SetBinary(void *instance, const uint32_t *references, size_t count, const size_t *sizes,
                  const uint8_t *const *values, size_t total) {
    Node *node = instance;
    for (size_t at = 0; at + 8 <= sizes[0]; at += value_of(values[0] + at + 4)) receive(node, values[0] + at);
    plan(node);
    node->active = node->length > 0;
    return OK;
}

int fmi3GetBinary(void *instance, const uint32_t *references, size_t count, size_t *sizes,
                  const uint8_t **values, size_t total) {
    Node *node = instance;
    sizes[0] = node->length;
    values[0] = node->sent;
    node->ticked = 1;
    return OK;
}

int fmi3GetIntervalFraction(void *instance, const uint32_t *references, size_t count, uint64_t *counters,
                            uint64_t *resolutions, int *qualifiers) {
    Node *node = instance;
    counters[0] = (uint64_t)(node->due_ns - node->now_ns);
    resolutions[0] = NS_PER_S;
    qualifiers[0] = node->changed ? CHANGED : UNCHANGED;
    node->changed = 0;
    return OK;
}

int fmi3UpdateDiscreteStates(void *instance, _Bool *again, _Bool *ends, _Bool *nominals, _Bool *states,
                             _Bool *known, double *next_s) {
    Node *node = instance;
    *again = *nominals = *states = *known = 0;
    *ends = node->kind == QUITTER && node->now_ns > 0;
    if (node->ticked) node->length = 0;
    if (node->ticked) plan(node);
    node->ticked = 0;
    return OK;
}

int fmi3DoStep(void *instance, double from_s, double step_s, _Bool no_set, _Bool *event, _Bool *ends,
               _Bool *early, double *last_s) {
    Node *node = instance;
    node->now_ns = (int64_t)((from_s + step_s) * 1e9 + 0.5);
    while (node->kind == HANGER) {}
    if (node->triggered) act(node);
    node->active = node->length > 0;
    *event = node->triggered && node->active;
    *ends = 0;
    *early = node->kind == LAGGARD;
    *last_s = from_s + step_s;
    return OK;
}

/* The standard asks for all functions; these nodes have no use for the rest. */
#define REST(name) int fmi3##name(void) { return ERROR; }
REST(ActivateModelPartition) REST(CompletedIntegratorStep) REST(DeserializeFMUState) REST(EnterConfigurationMode)
REST(EnterContinuousTimeMode) REST(EvaluateDiscreteStates) REST(ExitConfigurationMode) REST(FreeFMUState)
REST(GetAdjointDerivative) REST(GetBoolean) REST(GetContinuousStateDerivatives) REST(GetContinuousStates)
REST(GetDirectionalDerivative) REST(GetEventIndicators) REST(GetFMUState) REST(GetFloat32) REST(GetFloat64)
REST(GetInt16) REST(GetInt32) REST(GetInt64) REST(GetInt8) REST(GetIntervalDecimal)
REST(GetNominalsOfContinuousStates) REST(GetNumberOfContinuousStates) REST(GetNumberOfEventIndicators)
REST(GetNumberOfVariableDependencies) REST(GetOutputDerivatives) REST(GetShiftDecimal) REST(GetShiftFraction)
REST(GetString) REST(GetUInt16) REST(GetUInt32) REST(GetUInt64) REST(GetUInt8) REST(GetVariableDependencies)
REST(Reset) REST(SerializeFMUState) REST(SerializedFMUStateSize) REST(SetContinuousStates) REST(SetFMUState)
REST(SetFloat32) REST(SetFloat64) REST(SetInt16) REST(SetInt64) REST(SetInt8) REST(SetIntervalDecimal)
REST(SetIntervalFraction) REST(SetShiftDecimal) REST(SetShiftFraction) REST(SetString) REST(SetTime)
REST(SetUInt16) REST(SetUInt32) REST(SetUInt64) REST(SetUInt8)
