!> The &campbell group of a scene.
module viscovib_campbell_groups
  use viscovib_campbell_job, only: campbell_job
  use viscovib_grids, only: linear_grid
  use viscovib_group_reader, only: group_reader
  use viscovib_kinds, only: wp
  use viscovib_namelist, only: lower
  use viscovib_status, only: show
  implicit none
  private

  public :: read_campbell

contains

  subroutine read_campbell(reader, names, job)
    type(group_reader), intent(inout) :: reader
    !> Coordinates of the system.
    character(len=*), intent(in) :: names(:)
    type(campbell_job), intent(inout) :: job
    character(len=len(names)), allocatable :: words(:)
    real(wp) :: first, last
    integer :: i, n

    first = reader%read_real('speed_from')
    last = reader%read_real('speed_to')
    n = reader%read_integer('speed_count')
    job%orders = reader%read_reals('orders', default=[1.0_wp])
    if (reader%may_have('plane')) then
      allocate (words(0))
      words = reader%read_words('plane', len(names), 2)
      if (reader%status%failed()) return
      job%plane(:size(words)) = [(findloc(names, lower(words(i)), 1), i=1, size(words))]
      if (any(job%plane == 0) .or. job%plane(1) == job%plane(2)) then
        call reader%complain('plane', 'plane: must be two of the coordinates')
      end if
    end if
    if (reader%status%failed()) return
    if (last <= first) call reader%complain('speed_to', 'speed_to = '//show(last) &
                                            //': must be greater than speed_from = '//show(first))
    job%speeds = linear_grid(first, last, n)
  end subroutine read_campbell

end module viscovib_campbell_groups
