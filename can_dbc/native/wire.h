/* Frames of the train bus in C: scaling, alive counter, CRC-16, inverted twin and receive checks.
 *
 * frames.h, which can_dbc.c_source generates from the DBC files, adds one structure and one pair of
 * functions for each message. Both files need nothing but C11 and may be used without Python.
 * can_dbc/codec.py is the readable reference; property tests compare the two.
 */
#ifndef WIRE_H
#define WIRE_H

#include <math.h>
#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>
#include <string.h>

#define WIRE_BYTES_MAX 8
#define WIRE_TWIN_NS 20000000 /* Maximum time between the two halves of a vital pair. */
#define WIRE_STEP_MAX 3       /* Largest step of the alive counter that counts as lost frames. */

enum wire_protection { WIRE_NONE, WIRE_SAFETY, WIRE_VITAL };
enum wire_kind { WIRE_FLOAT, WIRE_INT, WIRE_BOOL, WIRE_ENUM };

struct wire_field {
    const char *name;
    enum wire_kind kind;
    size_t offset; /* Place of the value in the message's structure. */
};

struct wire_message {
    const char *name;
    uint16_t id, twin_id;
    uint8_t length; /* Bytes of the frame, with counter and CRC. */
    enum wire_protection protection;
    uint16_t crc, twin_crc; /* State of the CRC after the data identifier, which is never sent. */
    size_t size;            /* Bytes of the structure. */
    size_t count;
    const struct wire_field *fields;
    uint64_t (*pack)(const void *from);
    bool (*unpack)(uint64_t bits, void *to); /* False: a value is outside its range or table. */
};

/* Raw value of a number; beyond the range of the signal it is the end of the range. */
static inline uint64_t wire_scaled(double value, double least, double most, int64_t least_raw,
                                   int64_t most_raw, double offset, double scale)
{
    if (value <= least)
        return (uint64_t)least_raw;
    if (value >= most)
        return (uint64_t)most_raw;
    return (uint64_t)llrint((value - offset) / scale);
}

static inline uint64_t wire_counted(int64_t value, double least, double most, int64_t least_raw,
                                    int64_t most_raw, int64_t offset)
{
    if ((double)value <= least)
        return (uint64_t)least_raw;
    if ((double)value >= most)
        return (uint64_t)most_raw;
    return (uint64_t)(value - offset);
}

static inline int64_t wire_signed(uint64_t raw, int bits)
{
    uint64_t sign = UINT64_C(1) << (bits - 1);
    return (int64_t)((raw ^ sign) - sign);
}

static inline uint64_t wire_load(const uint8_t *data, size_t length)
{
    uint64_t word = 0;
    for (size_t at = 0; at < length; at++)
        word |= (uint64_t)data[at] << 8 * at;
    return word;
}

static inline void wire_store(uint64_t word, uint8_t *data, size_t length)
{
    for (size_t at = 0; at < length; at++)
        data[at] = (uint8_t)(word >> 8 * at);
}

/* CRC-16 of CCITT, polynomial 0x1021, four bits a step. */
static inline uint16_t wire_crc(uint16_t crc, const uint8_t *data, size_t length)
{
    static const uint16_t table[16] = {
        0x0000, 0x1021, 0x2042, 0x3063, 0x4084, 0x50a5, 0x60c6, 0x70e7,
        0x8108, 0x9129, 0xa14a, 0xb16b, 0xc18c, 0xd1ad, 0xe1ce, 0xf1ef,
    };
    for (size_t at = 0; at < length; at++) {
        crc = (uint16_t)(crc << 4 ^ table[crc >> 12 ^ data[at] >> 4]);
        crc = (uint16_t)(crc << 4 ^ table[crc >> 12 ^ (data[at] & 15)]);
    }
    return crc;
}

static inline int wire_counter_at(const struct wire_message *message)
{
    return 8 * (message->length - 3);
}

static inline uint64_t wire_payload_mask(const struct wire_message *message)
{
    return (UINT64_C(1) << wire_counter_at(message)) - 1;
}

static inline void wire_guard(const struct wire_message *message, uint64_t word, uint16_t crc,
                              uint8_t *data)
{
    size_t body = message->length - 2u;
    wire_store(word, data, body);
    crc = wire_crc(crc, data, body);
    data[body] = (uint8_t)crc;
    data[body + 1] = (uint8_t)(crc >> 8);
}

/* Write the frame, and for a vital message its inverted twin. `counter` is that of this frame. */
static inline void wire_send(const struct wire_message *message, uint64_t payload, uint8_t counter,
                             uint8_t *data, uint8_t *twin)
{
    if (message->protection == WIRE_NONE) {
        wire_store(payload, data, message->length);
        return;
    }
    uint64_t above = (uint64_t)counter << wire_counter_at(message);
    wire_guard(message, payload | above, message->crc, data);
    if (message->protection == WIRE_VITAL)
        wire_guard(message, (payload ^ wire_payload_mask(message)) | above, message->twin_crc, twin);
}

/* Results of the receive checks. All but the first two reject a frame. */
enum wire_verdict {
    WIRE_ACCEPTED,
    WIRE_FIRST_HALF, /* A first half waits for its twin. */
    WIRE_WRONG_LENGTH,
    WIRE_WRONG_CRC,
    WIRE_STUCK_COUNTER,
    WIRE_JUMPED_COUNTER,
    WIRE_INVALID_VALUE,
    WIRE_ALONE,       /* A first half waits; the one before it never had a twin. */
    WIRE_NO_FIRST,    /* A twin without a first half. */
    WIRE_LATE_TWIN,
    WIRE_NOT_INVERSE,
};

struct wire_receiver {
    int64_t silence_ns; /* Silence after which any counter is accepted as a new start. */
    bool heard, refused;
    int64_t heard_ns;   /* Last frame of the accepted stream, counting on or stuck. */
    int64_t refused_ns; /* Last frame whose counter jumped. */
    uint8_t value, candidate;
    int lost;          /* Frames lost before the last accepted one. */
    uint8_t last;      /* Counter before the frame that was checked last. */
    bool waiting;      /* A first half waits for its twin. */
    uint64_t first;
    int64_t first_ns;
};

static inline bool wire_may_begin(const struct wire_receiver *from, uint8_t value, int64_t at_ns)
{
    bool alone = !from->refused || at_ns - from->refused_ns > from->silence_ns;
    return alone || (uint8_t)(value - from->candidate) == 1;
}

static inline enum wire_verdict wire_count(struct wire_receiver *from, uint8_t value, int64_t at_ns)
{
    uint8_t step = (uint8_t)(value - from->value);
    bool silent = !from->heard || at_ns - from->heard_ns > from->silence_ns;
    from->lost = 0;
    from->last = from->value;
    if (!(silent && wire_may_begin(from, value, at_ns))) {
        if (step == 0) {
            /* A stuck sender ends the silence, so it is never accepted as a new stream. */
            from->heard = true;
            from->heard_ns = at_ns;
            return WIRE_STUCK_COUNTER;
        }
        if (step > WIRE_STEP_MAX) {
            from->candidate = value;
            from->refused = true;
            from->refused_ns = at_ns;
            return WIRE_JUMPED_COUNTER;
        }
        from->lost = step - 1;
    }
    from->value = value;
    from->heard = true;
    from->heard_ns = at_ns;
    return WIRE_ACCEPTED;
}

/* Check length and CRC; the word is the payload with the counter above it. */
static inline enum wire_verdict wire_open(const struct wire_message *message, uint16_t crc,
                                          const uint8_t *data, size_t length, uint64_t *word)
{
    if (length != message->length)
        return WIRE_WRONG_LENGTH;
    size_t body = length - 2;
    if (wire_crc(crc, data, body) != (data[body] | data[body + 1] << 8))
        return WIRE_WRONG_CRC;
    *word = wire_load(data, body);
    return WIRE_ACCEPTED;
}

/* Check a frame, or the first half of a vital pair; `bits` is its payload. */
static inline enum wire_verdict wire_receive(const struct wire_message *message,
                                             struct wire_receiver *from, const uint8_t *data,
                                             size_t length, int64_t at_ns, uint64_t *bits)
{
    if (message->protection == WIRE_NONE) {
        if (length != message->length)
            return WIRE_WRONG_LENGTH;
        *bits = wire_load(data, length);
        return WIRE_ACCEPTED;
    }
    uint64_t word;
    enum wire_verdict verdict = wire_open(message, message->crc, data, length, &word);
    if (verdict == WIRE_ACCEPTED)
        verdict = wire_count(from, (uint8_t)(word >> wire_counter_at(message)), at_ns);
    if (verdict != WIRE_ACCEPTED)
        return verdict;
    *bits = word & wire_payload_mask(message);
    if (message->protection == WIRE_SAFETY)
        return WIRE_ACCEPTED;
    bool alone = from->waiting;
    from->waiting = true;
    from->first = word;
    from->first_ns = at_ns;
    return alone ? WIRE_ALONE : WIRE_FIRST_HALF;
}

/* Check the inverted twin of a vital message; `bits` is the payload of the first half. */
static inline enum wire_verdict wire_receive_twin(const struct wire_message *message,
                                                  struct wire_receiver *from, const uint8_t *data,
                                                  size_t length, int64_t at_ns, uint64_t *bits)
{
    uint64_t word;
    enum wire_verdict verdict = wire_open(message, message->twin_crc, data, length, &word);
    if (verdict != WIRE_ACCEPTED)
        return verdict;
    if (!from->waiting)
        return WIRE_NO_FIRST;
    from->waiting = false;
    if (at_ns - from->first_ns > WIRE_TWIN_NS)
        return WIRE_LATE_TWIN;
    if ((from->first ^ word) != wire_payload_mask(message))
        return WIRE_NOT_INVERSE;
    *bits = from->first & wire_payload_mask(message);
    return WIRE_ACCEPTED;
}

#endif
