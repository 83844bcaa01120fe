!> The &load groups of a scene.
module viscovib_load_groups
  use viscovib_group_reader, only: group_reader
  use viscovib_growing_text, only: growing_text
  use viscovib_kinds, only: wp
  use viscovib_load, only: load_type, new_load
  use viscovib_namelist, only: namelist_type
  use viscovib_status, only: show, status_type
  implicit none
  private

  public :: read_loads

  !> Bound that stops a slip of the pen before it fills the memory.
  integer, parameter :: max_order = 100000

contains

  !> Every &load is a term amplitude sin(order nu t + phase); they add up.
  subroutine read_loads(file, coordinates, base_direction, load, echo, status)
    type(namelist_type), intent(in) :: file
    character(len=*), intent(in) :: coordinates(:)
    !> How the coordinates move with the base.
    real(wp), intent(in) :: base_direction(:)
    type(load_type), intent(out) :: load
    !> Gets the canonical text of the groups added.
    type(growing_text), intent(inout) :: echo
    type(status_type), intent(out) :: status
    type(group_reader) :: reader
    character(len=:), allocatable :: word
    integer, allocatable :: orders(:)
    complex(wp), allocatable :: force(:, :), base(:)
    real(wp) :: amplitude, phase
    complex(wp) :: term
    integer :: i, n, kind, on

    n = count([(file%groups(i)%name == 'load', i=1, size(file%groups))])
    allocate (orders(n), force(size(coordinates), n), base(n))
    force = (0.0_wp, 0.0_wp)
    base = (0.0_wp, 0.0_wp)
    n = 0
    do i = 1, size(file%groups)
      if (file%groups(i)%name /= 'load') cycle
      n = n + 1
      kind = 1
      on = 1
      call reader%start(file%path, file%groups(i))
      word = reader%read_text('kind', 'force', [character(len=5) :: 'force', 'base'], kind)
      if (kind == 1) then
        word = reader%read_text('on', trim(coordinates(1)), coordinates, on)
      else
        call reader%refuse(['on'], 'the base moves as a whole; only a force has this key')
        if (.not. any(abs(base_direction) > 0.0_wp)) then
          call reader%complain('kind', "kind = 'base': needs base_direction in &system")
        end if
      end if
      orders(n) = reader%read_integer('order', 1)
      if (orders(n) < 0 .or. orders(n) > max_order) then
        call reader%complain('order', 'order = '//show(orders(n)) &
                             //': must be 0 (mean), 1, 2, ... '//show(max_order))
      end if
      amplitude = reader%read_real('amplitude')
      if (orders(n) == 0) then
        call reader%refuse(['phase'], 'the mean (order 0) has none')
        term = cmplx(0.0_wp, amplitude, wp)
      else
        phase = reader%read_real('phase', 0.0_wp)
        term = amplitude*cmplx(cos(phase), sin(phase), wp)
      end if
      if (kind == 1) then
        force(on, n) = term
      else
        base(n) = term
      end if
      call reader%close(echo, status)
      if (status%failed()) return
    end do
    call new_load(load, size(coordinates), orders, force, base, status)
  end subroutine read_loads

end module viscovib_load_groups
