!> The &pendulum group of a scene.
module viscovib_pendulum_groups
  use viscovib_group_reader, only: group_reader
  use viscovib_pendulum, only: new_pendulum, pendulum_parameters, pendulum_type
  use viscovib_status, only: status_type
  implicit none
  private

  public :: read_pendulum

contains

  subroutine read_pendulum(reader, pendulum)
    type(group_reader), intent(inout) :: reader
    type(pendulum_type), intent(out) :: pendulum
    type(pendulum_parameters) :: p
    type(status_type) :: built
    character(len=:), allocatable :: word

    p%e = reader%read_real('e')
    p%w2 = reader%read_real('w2')
    p%w3 = reader%read_real('w3')
    p%alpha = reader%read_real('alpha')
    p%damping(1) = reader%read_real('c1')
    p%damping(2) = reader%read_real('c2')
    p%damping(3) = reader%read_real('c3')
    p%load(1) = reader%read_real('f0')
    p%load(2) = reader%read_real('m01')
    p%load(3) = reader%read_real('m02')
    p%frequency(1) = reader%read_real('p1')
    p%frequency(2) = reader%read_real('p2')
    p%frequency(3) = reader%read_real('p3')
    word = reader%read_text('equations', choice=p%equations)
    if (reader%status%failed()) return
    call new_pendulum(pendulum, p, built)
    call reader%place(built)
  end subroutine read_pendulum

end module viscovib_pendulum_groups
