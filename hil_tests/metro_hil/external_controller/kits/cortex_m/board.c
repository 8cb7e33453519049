/* The board MPS2 with a Cortex-M3 (AN385), as QEMU emulates it: start, serial line, end.
 *
 * The serial line UART0 carries the messages of the bench. The C library reads and writes it through
 * the functions at the end; the processor sleeps while it waits for a byte.
 */
#include <errno.h>
#include <stdint.h>
#include <string.h>
#include <sys/stat.h>
#include <unistd.h>

#define REGISTER(address) (*(volatile uint32_t *)(address))

#define UART_DATA REGISTER(0x40004000U)
#define UART_STATE REGISTER(0x40004004U)
#define UART_CONTROL REGISTER(0x40004008U)
#define UART_INTERRUPT REGISTER(0x4000400CU)
#define UART_DIVIDER REGISTER(0x40004010U)
#define TX_FULL 1U
#define RX_FULL 2U
#define TX_AND_RX_ON 3U
#define RX_INTERRUPT_ON 8U
#define RX_INTERRUPT 2U
#define FASTEST 16U /* Least divider of the UART's clock. */

#define INTERRUPTS_ON REGISTER(0xE000E100U)
#define INTERRUPTS_CLEAR REGISTER(0xE000E280U)
#define UART_RX_LINE 1U /* Bit of interrupt 0. */

#define TICK_CONTROL REGISTER(0xE000E010U)
#define TICK_RELOAD REGISTER(0xE000E014U)
#define TICK_ON 7U /* With its interrupt, by the processor's clock of 25 MHz. */
#define TICK_PASSED 0x10000U
#define TICK_CLEAR REGISTER(0xE000ED04U)
#define TICK_PENDING 0x2000000U
#define TICK_CYCLES 12500000U /* Half a second. */
#define SILENT_TICKS 1200U /* The bench has died without a word after ten minutes. */

/* Semihosting: operations of the emulator instead of those of an operating system. */
#define WRITE_CHARACTER 0x03U
#define EXIT_EXTENDED 0x20U
#define APPLICATION_EXIT 0x20026U

#define HEAP_BYTES 65536U /* The C library needs some to convert numbers. */

extern uint32_t data_load[], data_begin[], data_end[], bss_begin[], bss_end[], stack_top[];
int main(void);
void board_start(void);
void board_fault(void);

int _read(int file, char *to, int length);
int _write(int file, const char *from, int length);
void *_sbrk(ptrdiff_t more);
int _close(int file);
int _fstat(int file, struct stat *status);
int _isatty(int file);
off_t _lseek(int file, off_t offset, int whence);
int _kill(int process, int number);
int _getpid(void);

static char heap[HEAP_BYTES];
static size_t heap_used;

static void ask_emulator(uint32_t operation, const void *argument)
{
    register uint32_t r0 __asm__("r0") = operation;
    register const void *r1 __asm__("r1") = argument;
    __asm__ volatile("bkpt 0xAB" : "+r"(r0) : "r"(r1) : "memory");
}

void _exit(int status)
{
    const uint32_t block[2] = {APPLICATION_EXIT, (uint32_t)status};
    for (;;) {
        ask_emulator(EXIT_EXTENDED, block);
    }
}

/* Any fault of the processor ends the program. */
void board_fault(void)
{
    _exit(3);
}

void board_start(void)
{
    (void)memcpy(data_begin, data_load, (size_t)((char *)data_end - (char *)data_begin));
    (void)memset(bss_begin, 0, (size_t)((char *)bss_end - (char *)bss_begin));
    UART_DIVIDER = FASTEST;
    UART_CONTROL = TX_AND_RX_ON | RX_INTERRUPT_ON;
    /* A masked interrupt wakes the processor all the same, and no handler is needed. */
    __asm__ volatile("cpsid i");
    INTERRUPTS_ON = UART_RX_LINE;
    TICK_RELOAD = TICK_CYCLES;
    TICK_CONTROL = TICK_ON;
    _exit(main());
}

/* The table that a Cortex-M reads first: its stack, its start, and what every exception does. */
struct vectors {
    uint32_t *stack;
    void (*entries[15])(void);
};
__attribute__((section(".vectors"), used)) static const struct vectors vectors = {
    stack_top,
    {board_start, board_fault, board_fault, board_fault, board_fault, board_fault, board_fault,
     board_fault, board_fault, board_fault, board_fault, board_fault, board_fault, board_fault,
     board_fault},
};

static char received(void)
{
    uint32_t ticks = 0U;
    while ((UART_STATE & RX_FULL) == 0U) {
        __asm__ volatile("wfi");
        UART_INTERRUPT = RX_INTERRUPT;
        INTERRUPTS_CLEAR = UART_RX_LINE;
        TICK_CLEAR = TICK_PENDING;
        ticks += ((TICK_CONTROL & TICK_PASSED) != 0U) ? 1U : 0U;
        if (ticks >= SILENT_TICKS) {
            _exit(4);
        }
    }
    return (char)UART_DATA;
}

/* What the C library needs */

int _read(int file, char *to, int length)
{
    (void)file;
    for (int at = 0; at < length; at++) {
        to[at] = received();
    }
    return length;
}

int _write(int file, const char *from, int length)
{
    for (int at = 0; at < length; at++) {
        if (file == STDERR_FILENO) {
            ask_emulator(WRITE_CHARACTER, &from[at]);
        } else {
            while ((UART_STATE & TX_FULL) != 0U) {
            }
            UART_DATA = (uint8_t)from[at];
        }
    }
    return length;
}

void *_sbrk(ptrdiff_t more)
{
    void *block = &heap[heap_used];
    if ((more < 0) || ((size_t)more > (HEAP_BYTES - heap_used))) {
        errno = ENOMEM;
        block = (void *)-1;
    } else {
        heap_used += (size_t)more;
    }
    return block;
}

int _fstat(int file, struct stat *status)
{
    (void)file;
    status->st_mode = S_IFCHR;
    return 0;
}

int _isatty(int file)
{
    (void)file;
    return 1;
}

int _close(int file)
{
    (void)file;
    return -1;
}

off_t _lseek(int file, off_t offset, int whence)
{
    (void)file;
    (void)offset;
    (void)whence;
    return 0;
}

int _kill(int process, int number)
{
    (void)process;
    _exit(number);
    return 0;
}

int _getpid(void)
{
    return 1;
}
