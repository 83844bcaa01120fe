! Optimize: -O3
!> Tasks about relaxation kernels. A kernel is given by its kind and parameters as in
!! `viscovib_catalogue`.
module viscovib_kernel_tasks
  use viscovib_catalogue, only: new_kernel
  use viscovib_kernel_doubts, only: doubt_integral, doubt_table
  use viscovib_kernel_holder, only: kernel_holder
  use viscovib_kinds, only: i8, wp
  use viscovib_task, only: built_kernel, task_type
  implicit none
  private

  public :: kernel_task

contains

  !> Create an object from `kind` (integer) and `data` (n).
  subroutine build_kernel(task)
    type(task_type), intent(inout) :: task
    type(built_kernel), allocatable :: own
    real(wp), pointer, contiguous :: data(:)
    integer :: kind

    allocate (own)
    kind = task%get_integer('kind')
    data => task%get_reals('data')
    if (task%failed()) return
    call new_kernel(own%it%kernel, kind, data, task%status)
    if (.not. task%failed()) call move_alloc(own, task%built)
  end subroutine build_kernel

  !> Evaluate a property of a kernel at all points.
  subroutine kernel_task(task, name)
    type(task_type), intent(inout), target :: task
    character(len=*), intent(in) :: name
    type(kernel_holder), pointer :: kernel
    real(wp), pointer, contiguous :: points(:)
    complex(wp), pointer, contiguous :: s(:), transform(:)
    real(wp), allocatable :: values(:), weights(:), rates(:)
    character(len=:), allocatable :: text
    integer :: lost

    if (name == 'new') then
      call build_kernel(task)
      return
    else if (name == 'doubt') then
      ! A line about the `total` integral of a kernel, or nothing.
      call doubt_integral(task%get_real('total'), text)
      call task%found%put_text('text', text)
      return
    end if
    kernel => task%kernel()
    if (task%failed()) return
    associate (kernel => kernel%kernel)
      select case (name)
      case ('transform')
        ! R_c - i R_s at `mu` (n); `lost`: how many of them are not finite numbers.
        points => task%get_reals('mu')
        transform => task%found%new_complexes('values', shape(points))
        call transform_at(kernel, points, transform, lost)
        call task%found%put_integer('lost', int(lost, i8))
      case ('laplace')
        ! Laplace transform at complex `s` (n).
        s => task%get_complexes('s')
        transform => task%found%new_complexes('values', shape(s))
        call kernel%laplace(s, transform)
      case ('value')
        ! R(t) at `t` (n) > 0.
        points => task%get_reals('t')
        allocate (values(size(points)))
        call kernel%value(points, values)
        call task%found%put_reals('values', values, shape(values))
      case ('accumulated')
        ! integral_0^t R(s) ds at `t` (n) > 0.
        points => task%get_reals('t')
        allocate (values(size(points)))
        call kernel%accumulated(points, values)
        call task%found%put_reals('values', values, shape(values))
      case ('integral')
        ! +infinity if there is none; `doubt`: a line about the part that a table does not hold.
        call task%found%put_real('integral', kernel%integral())
        call doubt_table(kernel, text)
        call task%found%put_text('doubt', text)
      case ('exponentials')
        ! R(t) as a sum of exponentials from t_min to t_max; empty if there is no such sum.
        call kernel%exponentials(task%get_real('tolerance'), task%get_real('t_min'), &
                                 task%get_real('t_max'), weights, rates)
        call task%found%put_reals('weights', weights, shape(weights))
        call task%found%put_reals('rates', rates, shape(rates))
      case default
        call task%refuse_kind()
      end select
    end associate
  end subroutine kernel_task

  subroutine transform_at(kernel, mu, transform, lost)
    use viscovib_kernel, only: kernel_type
    class(kernel_type), intent(in) :: kernel
    real(wp), intent(in) :: mu(:)
    complex(wp), intent(out) :: transform(:)
    integer, intent(out) :: lost
    !> Size of parts that stay in cache between both passes.
    integer, parameter :: part = 1024
    real(wp) :: cosine(part), sine(part)
    integer :: first, m
    lost = 0
    do first = 1, size(mu), part
      m = min(part, size(mu) - first + 1)
      call kernel%transform(mu(first:first + m - 1), cosine(:m), sine(:m))
      transform(first:first + m - 1) = cmplx(cosine(:m), -sine(:m), wp)
      lost = lost + count(.not. abs(cosine(:m)) + abs(sine(:m)) <= huge(1.0_wp))
    end do
  end subroutine transform_at

end module viscovib_kernel_tasks
