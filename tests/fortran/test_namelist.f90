!> Namelist files: values read, and the location of errors.
module test_namelist
  use test_scene_files, only: remove_scratch, scratch, write_scratch
  use testing, only: begin, check, check_close, check_fails, check_ok
  use viscovib_group_reader, only: group_reader
  use viscovib_growing_text, only: growing_text
  use viscovib_kinds, only: wp
  use viscovib_namelist, only: namelist_type, read_namelist
  use viscovib_number_text, only: exact, exact_list, parse_integer, parse_real
  use viscovib_status, only: status_input_error, status_io_error, status_type
  implicit none
  private

  public :: run_namelist

  character(len=*), parameter :: nl = new_line('a')

contains

  subroutine run_namelist()
    type(namelist_type) :: file
    type(group_reader) :: reader
    type(status_type) :: status
    real(wp), allocatable :: list(:)

    ! Allocated, because gfortran 12 would report assignments to it as uses.
    allocate (list(0))
    if (begin('numbers are read strictly')) call check_numbers()

    if (begin('groups, comments, lists, repeats, quotes')) then
      call read_file('! first'//nl//'&Parameters a = 1.5, B=2 ! &two x=1 /'//nl &
                     //' list = 1, 2*0.5'//nl//'  3e0'//nl &
                     //' word = ''it''''s / ! &'', other="say ""no""" /'//nl &
                     //'&two/&one/', file, status)
      call check_ok(status)
      call check(size(file%groups) == 3, 'three groups')
      call check(file%groups(1)%name == 'parameters' .and. file%groups(1)%line == 2, 'first group')
      call check(file%groups(3)%line == 6, 'line of the last group')
      call reader%start('f', file%groups(1))
      call check_close(reader%read_real('a'), 1.5_wp, 0.0_wp, 'a')
      call check(reader%read_integer('b') == 2, 'b')
      list = reader%read_reals('list', 4)
      call check_close(sum(abs(list - [1.0_wp, 0.5_wp, 0.5_wp, 3.0_wp])), 0.0_wp, 0.0_wp, 'list')
      call check(reader%read_text('word') == "it's / ! &", 'word')
      call check(reader%read_text('other') == 'say "no"', 'other')
      call check(reader%read_integer('none', 7) == 7, 'default')
      call reader%finish()
      call check_ok(reader%status)
    end if

    if (begin('Windows line ends and a mark of byte order')) then
      call read_file(char(239)//char(187)//char(191)//'&one a = 1'//achar(13)//nl//' b = 2' &
                     //achar(13) &
                     //nl//'/'//achar(13)//nl, file, status)
      call check_ok(status)
      call check(file%groups(1)%entries(2)%line == 2, 'line of b')
    end if

    if (begin('what is wrong with the text, and where')) then
      call wrong('', ': no group such as &mount')
      call wrong('! only this'//nl, ': no group such as &mount')
      call wrong('a = 1', ':1: ''a'' stands outside a group')
      call wrong('&one'//nl//' a = 1'//nl, ':1: &one is not ended')
      call wrong('&one a = 1'//nl//'&two b = 2 /', ':2: ''&two'' inside &one (line 1)')
      call wrong('& a = 1 /', ':1: & without a name')
      call wrong('&one a 1 /', ':1: ''a'' in &one is not followed by ''=''')
      call wrong('&one'//nl//'a = /', ':2: a has no value')
      call wrong('&one a = 1'//nl//' A = 2 /', ':2: a is given twice in &one (first in line 1)')
      call wrong('&one a = ''text'//nl//''' /', ':1: a: the quoted text is not ended')
      call wrong('&one a = ''te'//achar(13)//'xt'' /', ':1: a: the quoted text is not ended')
      call wrong('&one a = 1 &'//nl//' /', ':1: ''&'' inside &one (line 1)')
      call wrong('&one a = 1'//nl//' ,, 2 /', ':2: a: no value before a comma')
      call wrong('&one a = , 2 /', ':1: a: no value before a comma')
      call wrong('&one a = 0*1 /', ':1: a = 0*1: must be a value, or a count')
      call wrong('&one a = 2* /', ':1: a = 2*: must be a value, or a count')
      call wrong('&one a = 99999999999*1 /', ':1: a = 99999999999*1: must be a value, or a count')
      call wrong('&one a = 600000*1 600000*2 /', ':1: a: a scene must have at most 1000000 values')
      call wrong('&one'//nl//achar(0)//' /', ':2: byte 0 found')
      call wrong('&one'//nl//' a = ''caf'//char(233)//''' /', ':2: byte 233 found')
      call wrong('&one /'//nl//char(195), ':2: byte 195 found')
    end if

    if (begin('a file that is not there, a folder')) then
      call remove_scratch('none.nml')
      call read_namelist(scratch('none.nml'), file, status)
      call check_fails(status, 'none.nml: cannot be read (No such file')
      call check(status%category == status_io_error, 'an i/o error')
      call read_namelist('.', file, status)
      call check_fails(status, '.: cannot be read (')
      call check(status%category == status_io_error, 'an i/o error')
    end if

    if (begin('values of the wrong type, number or size')) then
      call wrong_value('min = 1 2', ':2: min has 2 values: must be a number')
      call wrong_value('min = ''1''', ':2: min = 1: must be a number')
      call wrong_value('min = .true.', ':2: min = .true.: must be a finite number')
      call wrong_value('min = 1e999', ':2: min = 1e999: must be a finite number')
      call wrong_value('min = nan', ':2: min = nan: must be a finite number')
      call wrong_value('min = 1-2', ':2: min = 1-2: must be a finite number')
      call wrong_value('count = 1', ':1: &sweep lacks min')
      call wrong_value('min = 1, count = 1.5', ':2: count = 1.5: must be an integer')
      call wrong_value('min = 1, count = 3000000000', 'must be an integer of at most 2147483647')
      call wrong_value('min = 1, spacing = 3', ':2: spacing = 3: must be a quoted text')
      call wrong_value('min = 1, spacing = ''no''', &
                       "spacing = 'no': must be one of 'linear', 'log'")
      call wrong_value('min = 1, values = 1 2', ':2: values has 2 values: must be 3')
      call wrong_value('min = 1, values = 1 ''x'' 3', "values = 'x': must be numbers")
      call wrong_value('min = 1, spacign = ''log''', &
                       "unknown key 'spacign' in &sweep; did you mean 'spacing'?")
      call wrong_value('min = 1, '//repeat('w', 5000)//' = 1', &
                       ': must be one of values, min, count')
      call wrong_value('min = 1, colour = 1', &
                       "unknown key 'colour' in &sweep: must be one of values, min, count, spacing")
    end if

    if (begin('texts grow from pieces of any length')) call check_growing()

    if (begin('what is too much')) then
      call wrong('&one '//repeat('a', 200)//' 1 /', ':1: '''//repeat('a', 57) &
                 //'...'' in &one is not followed by ''=''')
      call wrong('&one a = '''//repeat('x', 65537)//''' /', ':1: a: must have at most 65536 char')
      call wrong('&one a = '''//repeat('''''', 65537)//''' /', ':1: a: must have at most 65536')
      call wrong('&one a = '//repeat('1', 65537)//' /', ':1: a: must have at most 65536 char')
      call wrong(repeat('&one /'//nl, 20001), ':20001: a scene must have at most 20000 groups')
      call wrong('&one '//many_keys(101)//' /', ':1: &one: must have at most 100 keys')
      call wrong('&one a = 600000*1 b = 600000*2 /', ':1: b: a scene must have at most 1000000')
      call wrong_value('min = 1, count = -2147483648', 'must be an integer of at least -2147483647')
      call wrong_value('min = 1, values = 999999*1', ':2: values has 999999 values: must be 3')
      call wrong_value('min = '//repeat('9', 500), '999...: must be a finite number')
    end if

    if (begin('a long list takes no time')) then
      call read_file('&parameters list = '//repeat('1.5 2.5,', 50000)//' /', file, status)
      call reader%start('f', file%groups(1))
      list = reader%read_reals('list')
      call reader%finish()
      call check(size(list) == 100000, 'all values')
      call check_close(sum(list), 200000.0_wp, 0.0_wp, 'sum')
    end if
    call remove_scratch('test.nml')
  end subroutine run_namelist

  !> a1 = 1 a2 = 1 ...
  function many_keys(n) result(text)
    integer, intent(in) :: n
    character(len=:), allocatable :: text
    character(len=12) :: one
    integer :: i
    text = ''
    do i = 1, n
      write (one, '(a,i0,a)') 'a', i, ' = 1 '
      text = text//one
    end do
  end function many_keys

  subroutine check_growing()
    type(growing_text) :: text
    character(len=:), allocatable :: plain
    integer :: i

    call check(text%text() == '' .and. text%length() == 0, 'nothing')
    plain = ''
    do i = 0, 400
      call text%add(repeat(achar(65 + mod(i, 26)), i))
      plain = plain//repeat(achar(65 + mod(i, 26)), i)
    end do
    call check(text%length() == len(plain), 'its length')
    call check(text%text() == plain, 'all pieces in their order')
  end subroutine check_growing

  subroutine check_numbers()
    character(len=*), parameter :: bad(16) = &
      [character(len=8) :: '1-2', '1+2', 'e5', '1e', '1e+', '.', '-', '+-1', '1.2.3', '1e5d3', &
       '0x10', 'nan', 'inf', '1e999', '1e-999', '1/2']
    character(len=*), parameter :: good(8) = &
      [character(len=8) :: '1', '+1.', '.01e2', '1.e0', '10d-1', '1E+0', '0.1D1', '1.000']
    real(wp) :: value, back
    integer :: i, whole
    logical :: ok

    do i = 1, size(good)
      call parse_real(trim(good(i)), value, ok)
      call check(ok, trim(good(i))//' is a number')
      call check_close(value, 1.0_wp, 0.0_wp, trim(good(i)))
    end do
    do i = 1, size(bad)
      call parse_real(trim(bad(i)), value, ok)
      call check(.not. ok, trim(bad(i))//' is not a number')
    end do
    call parse_real('', value, ok)
    call check(.not. ok, 'nothing is not a number')
    call parse_real('-0e-999', value, ok)
    call check(ok, 'zero may have any exponent')
    call parse_integer('-12', whole, ok)
    call check(ok .and. whole == -12, '-12')
    call parse_integer('1.0', whole, ok)
    call check(.not. ok, '1.0 is not an integer')

    value = 1.0_wp/3.0_wp
    do i = 1, 20
      value = value*(-7.3_wp)**i
      value = nearest(value, 1.0_wp - value)
      call parse_real(trim(exact(value)), back, ok)
      call check(ok, 'written numbers are read')
      call check_close(back, value, 0.0_wp, 'there and back')
    end do
    call check(len(exact_list([real(wp) ::])) == 0, 'an empty list')
    call check(index(exact_list([1.0_wp, 2.0_wp, 3.0_wp, 4.0_wp]), nl) == 0, 'four in a line')
    call check(index(exact_list([1.0_wp, 2.0_wp, 3.0_wp, 4.0_wp, 5.0_wp]), nl) > 0, 'not five')
  end subroutine check_numbers

  subroutine read_file(text, file, status)
    character(len=*), intent(in) :: text
    type(namelist_type), intent(out) :: file
    type(status_type), intent(out) :: status
    call write_scratch('test.nml', text)
    call read_namelist(scratch('test.nml'), file, status)
  end subroutine read_file

  !> The text must be refused with this message after the file name.
  subroutine wrong(text, message)
    character(len=*), intent(in) :: text, message
    type(namelist_type) :: file
    type(status_type) :: status
    call read_file(text, file, status)
    call check_fails(status, scratch('test.nml')//message)
    call check(status%category == status_input_error, 'an input error')
  end subroutine wrong

  !> A group &sweep of these keys is read and must fail.
  subroutine wrong_value(keys, message)
    character(len=*), intent(in) :: keys, message
    type(namelist_type) :: file
    type(status_type) :: status
    type(group_reader) :: reader
    real(wp) :: a
    real(wp), allocatable :: list(:)
    character(len=:), allocatable :: word
    integer :: b
    allocate (list(0))
    call read_file('&sweep'//nl//keys//' /', file, status)
    call check_ok(status)
    call reader%start('f', file%groups(1))
    a = reader%read_real('min')
    b = reader%read_integer('count', 2)
    list = reader%read_reals('values', 3, [a, a, real(b, wp)])
    word = reader%read_text('spacing')
    call reader%finish()
    call check_fails(reader%status, message)
    call check(index(reader%status%message, 'f:') == 1, 'file and line first: '//word)
    call check(size(list) == 3, 'a list of the size asked for')
  end subroutine wrong_value

end module test_namelist
