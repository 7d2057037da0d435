#ifndef HOST_PGMSPACE_H
#define HOST_PGMSPACE_H
#define PROGMEM
#define pgm_read_dword(address) (*(address))
#endif
