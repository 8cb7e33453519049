/* Implementation of wire.h. can_dbc/codec.py is the readable reference; property tests compare them. */
#include "wire.h"

/* Nearest whole number, halves to the even one. */
static int64_t wire_rounded(double value)
{
    int64_t below = (int64_t)value;
    double above;
    if ((double)below > value) {
        below -= 1;
    }
    above = value - (double)below;
    if ((above > 0.5) || ((above == 0.5) && ((below % 2) != 0))) {
        below += 1;
    }
    return below;
}

/* Raw value of a number; beyond the range of the signal it is the end of the range. */
static inline uint64_t wire_scaled(double value, double least, double most, int64_t least_raw,
                                   int64_t most_raw, double offset, double scale)
{
    int64_t raw;
    if (value <= least) {
        raw = least_raw;
    } else if (value >= most) {
        raw = most_raw;
    } else {
        raw = wire_rounded((value - offset) / scale);
    }
    return (uint64_t)raw;
}

static inline uint64_t wire_counted(int64_t value, double least, double most, int64_t least_raw,
                                    int64_t most_raw, int64_t offset)
{
    int64_t raw;
    if ((double)value <= least) {
        raw = least_raw;
    } else if ((double)value >= most) {
        raw = most_raw;
    } else {
        raw = value - offset;
    }
    return (uint64_t)raw;
}

static inline int64_t wire_signed(uint64_t raw, unsigned int bits)
{
    const uint64_t sign = UINT64_C(1) << (bits - 1U);
    return (int64_t)((raw ^ sign) - sign);
}

static inline uint64_t wire_load(const uint8_t *data, size_t length)
{
    uint64_t word = 0U;
    for (size_t at = 0U; at < length; at++) {
        word |= (uint64_t)data[at] << (8U * at);
    }
    return word;
}

static inline void wire_store(uint64_t word, uint8_t *data, size_t length)
{
    for (size_t at = 0U; at < length; at++) {
        data[at] = (uint8_t)((word >> (8U * at)) & 0xFFU);
    }
}

/* CRC-16 of CCITT, polynomial 0x1021, four bits a step. */
static uint16_t wire_crc(uint16_t start, const uint8_t *data, size_t length)
{
    static const uint16_t table[16] = {
        0x0000U, 0x1021U, 0x2042U, 0x3063U, 0x4084U, 0x50a5U, 0x60c6U, 0x70e7U,
        0x8108U, 0x9129U, 0xa14aU, 0xb16bU, 0xc18cU, 0xd1adU, 0xe1ceU, 0xf1efU,
    };
    uint32_t crc = start;
    for (size_t at = 0U; at < length; at++) {
        crc = ((crc << 4U) & 0xFFFFU) ^ table[(crc >> 12U) ^ ((uint32_t)data[at] >> 4U)];
        crc = ((crc << 4U) & 0xFFFFU) ^ table[(crc >> 12U) ^ ((uint32_t)data[at] & 15U)];
    }
    return (uint16_t)crc;
}

/* messages */

static inline unsigned int wire_counter_at(const struct wire_message *message)
{
    return 8U * ((unsigned int)message->length - 3U);
}

static inline uint64_t wire_payload_mask(const struct wire_message *message)
{
    return (UINT64_C(1) << wire_counter_at(message)) - 1U;
}

static void wire_guard(const struct wire_message *message, uint64_t word, uint16_t start,
                       uint8_t *data)
{
    const size_t body = (size_t)message->length - 2U;
    uint16_t crc;
    wire_store(word, data, body);
    crc = wire_crc(start, data, body);
    data[body] = (uint8_t)(crc & 0xFFU);
    data[body + 1U] = (uint8_t)(crc >> 8U);
}

/* Write the frame, and for a vital message its inverted twin, with this counter. */
static void wire_seal(const struct wire_message *message, uint64_t payload, uint8_t counter,
                      uint8_t *data, uint8_t *twin)
{
    if (message->protection == WIRE_NONE) {
        wire_store(payload, data, message->length);
    } else {
        const uint64_t above = (uint64_t)counter << wire_counter_at(message);
        wire_guard(message, payload | above, message->crc, data);
        if (message->protection == WIRE_VITAL) {
            const uint64_t inverted = payload ^ wire_payload_mask(message);
            wire_guard(message, inverted | above, message->twin_crc, twin);
        }
    }
}

static inline bool wire_may_begin(const struct wire_receiver *from, int64_t silence_ns,
                                  uint8_t value, int64_t at_ns)
{
    const bool alone = !from->refused || ((at_ns - from->refused_ns) > silence_ns);
    return alone || ((((unsigned int)value - from->candidate) & 0xFFU) == 1U);
}

static enum wire_verdict wire_count(const struct wire_message *message, struct wire_receiver *from,
                                    uint8_t value, int64_t at_ns)
{
    const int64_t silence_ns = (from->silence_ns != 0) ? from->silence_ns : message->timeout_ns;
    const unsigned int step = ((unsigned int)value - from->value) & 0xFFU;
    const bool silent = !from->heard || ((at_ns - from->heard_ns) > silence_ns);
    const bool begins = silent && wire_may_begin(from, silence_ns, value, at_ns);
    enum wire_verdict verdict = WIRE_ACCEPTED;
    from->lost = 0U;
    from->last = from->value;
    if (!begins && (step == 0U)) {
        /* A stuck sender ends the silence, so it is never accepted as a new stream. */
        from->heard = true;
        from->heard_ns = at_ns;
        verdict = WIRE_STUCK_COUNTER;
    } else if (!begins && (step > WIRE_STEP_MAX)) {
        from->candidate = value;
        from->refused = true;
        from->refused_ns = at_ns;
        verdict = WIRE_JUMPED_COUNTER;
    } else {
        from->lost = begins ? 0U : (uint8_t)(step - 1U);
        from->value = value;
        from->heard = true;
        from->heard_ns = at_ns;
    }
    return verdict;
}

/* Check length and CRC; the word is the payload with the counter above it. */
static enum wire_verdict wire_open(const struct wire_message *message, uint16_t start,
                                   const uint8_t *data, size_t length, uint64_t *word)
{
    enum wire_verdict verdict = WIRE_ACCEPTED;
    if (length != message->length) {
        verdict = WIRE_WRONG_LENGTH;
    } else {
        const size_t body = length - 2U;
        const uint16_t found = (uint16_t)(data[body] | ((unsigned int)data[body + 1U] << 8U));
        if (wire_crc(start, data, body) != found) {
            verdict = WIRE_WRONG_CRC;
        } else {
            *word = wire_load(data, body);
        }
    }
    return verdict;
}

static enum wire_verdict wire_wait(struct wire_receiver *from, uint64_t word, int64_t at_ns)
{
    const bool alone = from->waiting;
    from->waiting = true;
    from->first = word;
    from->first_ns = at_ns;
    return alone ? WIRE_ALONE : WIRE_FIRST_HALF;
}

/* Check a frame, or the first half of a vital pair; `bits` is its payload. */
static enum wire_verdict wire_check(const struct wire_message *message, struct wire_receiver *from,
                                    const uint8_t *data, size_t length, int64_t at_ns,
                                    uint64_t *bits)
{
    enum wire_verdict verdict = WIRE_ACCEPTED;
    if (message->protection == WIRE_NONE) {
        if (length != message->length) {
            verdict = WIRE_WRONG_LENGTH;
        } else {
            *bits = wire_load(data, length);
        }
    } else {
        uint64_t word = 0U;
        verdict = wire_open(message, message->crc, data, length, &word);
        if (verdict == WIRE_ACCEPTED) {
            const uint8_t counter = (uint8_t)((word >> wire_counter_at(message)) & 0xFFU);
            verdict = wire_count(message, from, counter, at_ns);
        }
        if (verdict == WIRE_ACCEPTED) {
            *bits = word & wire_payload_mask(message);
            if (message->protection == WIRE_VITAL) {
                verdict = wire_wait(from, word, at_ns);
            }
        }
    }
    return verdict;
}

/* Check the inverted twin of a vital message; `bits` is the payload of the first half. */
static enum wire_verdict wire_check_twin(const struct wire_message *message,
                                         struct wire_receiver *from, const uint8_t *data,
                                         size_t length, int64_t at_ns, uint64_t *bits)
{
    uint64_t word = 0U;
    enum wire_verdict verdict = wire_open(message, message->twin_crc, data, length, &word);
    if (verdict == WIRE_ACCEPTED) {
        if (!from->waiting) {
            verdict = WIRE_NO_FIRST;
        } else {
            from->waiting = false;
            if ((at_ns - from->first_ns) > WIRE_TWIN_NS) {
                verdict = WIRE_LATE_TWIN;
            } else if ((from->first ^ word) != wire_payload_mask(message)) {
                verdict = WIRE_NOT_INVERSE;
            } else {
                *bits = from->first & wire_payload_mask(message);
            }
        }
    }
    return verdict;
}

size_t wire_encode(const struct wire_message *message, struct wire_sender *sender,
                   const void *values, struct wire_frame frames[WIRE_FRAMES_MAX])
{
    size_t count = 0U;
    uint64_t payload = 0U;
    if (message->pack(values, &payload)) {
        wire_seal(message, payload, sender->counter, frames[0].data, frames[1].data);
        sender->counter = (uint8_t)(((unsigned int)sender->counter + 1U) & 0xFFU);
        frames[0].id = message->id;
        frames[0].length = message->length;
        count = 1U;
        if (message->protection == WIRE_VITAL) {
            frames[1].id = message->twin_id;
            frames[1].length = message->length;
            count = 2U;
        }
    }
    return count;
}

enum wire_verdict wire_decode(const struct wire_message *message, struct wire_receiver *receiver,
                              const struct wire_frame *frame, int64_t at_ns, void *values)
{
    enum wire_verdict verdict = WIRE_OTHER_ID;
    uint64_t bits = 0U;
    if (frame->id == message->id) {
        verdict = wire_check(message, receiver, frame->data, frame->length, at_ns, &bits);
    } else if ((message->protection == WIRE_VITAL) && (frame->id == message->twin_id)) {
        verdict = wire_check_twin(message, receiver, frame->data, frame->length, at_ns, &bits);
    } else {
        /* The frame of another message changes nothing. */
    }
    if (verdict == WIRE_ACCEPTED) {
        if (message->unpack(bits, values)) {
            receiver->received = true;
            receiver->received_ns = at_ns;
        } else {
            verdict = WIRE_INVALID_VALUE;
        }
    }
    return verdict;
}

bool wire_is_fresh(const struct wire_message *message, const struct wire_receiver *receiver,
                   int64_t now_ns)
{
    return receiver->received && ((message->timeout_ns == 0) ||
                                  ((now_ns - receiver->received_ns) <= message->timeout_ns));
}

const struct wire_message *wire_find(uint32_t id)
{
    const struct wire_message *found = NULL;
    for (size_t at = 0U; (at < (size_t)WIRE_MESSAGES) && (found == NULL); at++) {
        const struct wire_message *each = &wire_messages[at];
        if ((each->id == id) || ((each->protection == WIRE_VITAL) && (each->twin_id == id))) {
            found = each;
        }
    }
    return found;
}
